"""Printing to any console: characters that its encoding lacks are replaced by similar ones in ASCII."""

from __future__ import annotations

import codecs
import unicodedata
from typing import TextIO

SIMILAR = {
    "×": "x", "–": "-", "—": "-", "−": "-", "…": "...", "≈": "~", "≤": "<=", "≥": ">=", "±": "+-", "→": "->",
    "·": "*", "•": "*", "█": "#", "─": "-", "━": "-", "│": "|", "┃": "|", "╸": "-", "╺": "-",
}  # fmt: skip


def accept_every_character(*streams: TextIO | None) -> None:
    """Let these text streams replace characters that they cannot encode, instead of raising UnicodeEncodeError."""
    codecs.register_error("rtdenoise", _replace)
    for stream in streams:
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="rtdenoise")


def _replace(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_similar, error.object[error.start : error.end])), error.end


def _similar(character: str) -> str:
    if "BOX DRAWINGS" in (name := unicodedata.name(character, "")):
        return SIMILAR.get(character, "-" if name.endswith("HORIZONTAL") else "+")
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return SIMILAR.get(character) or plain or "?"
