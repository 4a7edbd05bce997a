"""`rtdenoise denoise`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from ..run.denoise import Options, Summary
from .progress import progress_bar


@dataclass(frozen=True)
class Denoise:
    """Denoise a sequence of EXR files: one file of the same name each, the result in R,G,B."""

    source: Annotated[Positional[str], arg(metavar="SEQ")]
    """Folder of EXR files, or a glob in quotes."""
    out: Path
    """Folder for the denoised files; never the folder of the input."""
    settings: OmitArgPrefixes[Options] = field(default_factory=Options)
    overwrite: bool = False
    """Denoise all frames again, whatever --out holds."""
    preview: bool = False
    """Also write preview.png and an animation: noisy | denoised | reference."""

    def run(self) -> None:
        from ..run.denoise import denoise
        from ..run.memory import keep_freed

        keep_freed()
        with progress_bar("denoising") as bar:
            task = bar.add_task("denoise", total=None)
            summary = denoise(
                self.source, self.out, self.settings, self.overwrite,
                lambda done, total: bar.update(task, completed=done, total=total),
            )  # fmt: skip
        written, *more = told(summary)
        print("\n".join([f"{self.out}: {written}", *more]))
        if self.preview:
            print("preview:", ", ".join(map(str, self._preview())))

    def _preview(self) -> list[Path]:
        from ..data.sequences import open_sequence
        from ..run.preview import preview

        options = self.settings
        sequence = open_sequence(
            self.source, signal=options.signal, preset=options.preset, layers=("reference",),
            allow_gaps=options.allow_gaps,
        )  # fmt: skip
        return preview(sequence, self.out, options.layout, options.recombine)


def told(summary: Summary, stage: str = "denoiser") -> list[str]:
    """What a run did, a line a fact. Counts of replaced and left out include the frames of interrupted runs before."""
    frames = summary.written + summary.skipped
    lines = [f"{summary.written} frames written, {summary.skipped} were there"]
    if summary.written:
        lines.append(f"{stage}: {1000 * summary.seconds / summary.written:.0f} ms a frame")
    lines += summary.notes
    lines += [f"replaced: {what} in {count} pixels" for what, count in summary.replaced.items()]
    lines += [
        f"passed on as in the input: NaN in {count} pixels of {name}" for name, count in summary.passed_on.items()
    ]
    lines += [f"left out: {what} in {count} of {frames} frames" for what, count in summary.left_out.items() if count]
    if summary.cuts:
        lines.append(f"cuts: history starts anew at frame {', '.join(map(str, summary.cuts))}")
    return lines
