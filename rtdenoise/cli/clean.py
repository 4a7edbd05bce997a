"""`rtdenoise clean`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..wording import counted
from .progress import progress_bar


@dataclass(frozen=True)
class Clean:
    """Copy training clips with their references denoised by OIDN: for training, not for validation."""

    folder: Annotated[Positional[Path], arg(metavar="CLIPS")]
    """Folder of clips."""
    out: Path
    """Folder for the cleaned clips; clips that it holds already are kept."""

    def run(self) -> None:
        from ..training.clean import clean

        with progress_bar("cleaning") as bar:
            task = bar.add_task("clean", total=None)
            count = clean(self.folder, self.out, lambda done, total: bar.update(task, completed=done, total=total))
        print(f"{self.out}: {counted(count, 'clip')} written")
