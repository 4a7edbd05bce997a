"""`rtdenoise demo`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Demo:
    """Denoise the bundled sequence, print errors and times, and write pictures."""

    out: Path = Path("demo")
    """Folder for the pictures and numbers."""
    source: Path | None = None
    """Another sequence with references."""
    signal: str = "indirect"
    """'color' or 'indirect'."""

    def run(self) -> None:
        from ..evaluate.demo import demo

        demo(self.out, self.source, self.signal)
