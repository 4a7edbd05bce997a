"""JSON that every reader takes: Python writes NaN and Infinity into it, which JSON does not have."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping


def dumps(value: object, **options) -> str:
    """`json.dumps`, with null for numbers that are not finite."""
    return json.dumps(_finite(value), allow_nan=False, **options)


def _finite(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list | tuple) else value
