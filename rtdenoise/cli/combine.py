"""`rtdenoise combine`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from ..run.options import CombineOptions
from .denoise import told
from .progress import progress_bar


@dataclass(frozen=True)
class Combine:
    """Correct the frames of any denoiser by the noisy frames they were made from."""

    noisy: Annotated[Positional[str], arg(metavar="NOISY")]
    """Folder of noisy EXR files, or a glob in quotes."""
    denoised: Annotated[Positional[str], arg(metavar="DENOISED")]
    """The same frames, denoised: a folder, or a glob in quotes."""
    out: Path
    """Folder for the corrected files; never a folder of the input."""
    settings: OmitArgPrefixes[CombineOptions] = field(default_factory=CombineOptions)
    overwrite: bool = False
    """Correct all frames again, whatever --out holds."""

    def run(self) -> None:
        from ..run.combine import combine
        from ..run.memory import keep_freed

        keep_freed()
        with progress_bar("combining") as bar:
            task = bar.add_task("combine", total=None)
            summary = combine(
                self.noisy, self.denoised, self.out, self.settings, self.overwrite,
                lambda done, total: bar.update(task, completed=done, total=total),
            )  # fmt: skip
        written, *more = told(summary, "combiner")
        print("\n".join([f"{self.out}: {written}", *more]))
