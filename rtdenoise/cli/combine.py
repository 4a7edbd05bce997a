"""`rtdenoise combine`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from ..run.options import CombineOptions
from .denoise import refuse_file, told, write_preview
from .progress import frame_progress


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
    preview: bool = False
    """Also write preview.png and an animation: noisy | denoised | reference."""
    progress: Literal["bar", "lines"] = "bar"
    """How far it is: a bar, or a line such as 3/24 after each frame, for programs that show it themselves."""

    def run(self) -> None:
        from ..run.combine import combine
        from ..run.memory import keep_freed

        refuse_file(self.out)
        keep_freed()
        with frame_progress(self.progress, "combining") as on_frame:
            summary = combine(self.noisy, self.denoised, self.out, self.settings, self.overwrite, on_frame)
            written, *more = told(summary, "combiner")
            more += write_preview(self.settings, self.noisy, self.out) if self.preview else []
        print("\n".join([f"{self.out}: {written}", *more]))
