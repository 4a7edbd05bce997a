"""Lists of names on the command line."""

from __future__ import annotations

from collections.abc import Iterable


def split_names(words: Iterable[str]) -> tuple[str, ...]:
    """Names with commas or spaces between them, each once, in order."""
    return tuple(dict.fromkeys(name for word in words for name in word.split(",") if name))
