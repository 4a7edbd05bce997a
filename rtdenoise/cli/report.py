"""`rtdenoise report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from .lists import split_names


@dataclass(frozen=True)
class Report:
    """Turn the numbers and pictures of `evaluate` into report.html (one file that needs no network), report.md and
    report.png."""

    folder: Annotated[Positional[Path], arg(metavar="OUT")]
    """Folder that evaluate wrote."""
    pictures: Annotated[tuple[str, ...], arg(help_behavior_hint="(default: all)")] = ()
    """Methods whose pictures the page holds."""
    sequences: Annotated[tuple[str, ...], arg(help_behavior_hint="(default: all)")] = ()
    """Sequences whose pictures the page holds."""

    def run(self) -> None:
        from ..report import report

        written = report(self.folder, split_names(self.pictures), split_names(self.sequences))
        print("report:", ", ".join(map(str, written)))
        if "report.png" not in [path.name for path in written]:
            print("report.png needs matplotlib: pip install 'rtdenoise[bench]'")
