"""JSON that every reader takes: Python writes NaN and Infinity into it, which JSON does not have."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping


def dumps(value: object, digits: int | None = None, **options) -> str:
    """`json.dumps`, with null for numbers that are not finite, and the others rounded to so many significant digits."""
    return json.dumps(_plain(value, digits), allow_nan=False, **options)


def _plain(value: object, digits: int | None) -> object:
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else float(f"{value:.{digits}g}")
    if isinstance(value, Mapping):
        return {key: _plain(item, digits) for key, item in value.items()}
    return [_plain(item, digits) for item in value] if isinstance(value, list | tuple) else value
