"""The command line. Every command is a dataclass whose comments are its help; what is wrong with the input is one line
and exit 2."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import OmitArgPrefixes, Positional

from ..errors import InputError
from ..run.denoise import Options
from .clips import Clips
from .evaluate import Evaluate, Report
from .progress import progress_bar
from .render import Render, refuse_old_spelling
from .training import Clean, Train


@dataclass(frozen=True)
class Denoise:
    """Denoise a sequence of EXR files: one file of the same name each, the result in R,G,B."""

    source: Positional[str]
    """Folder of EXR files, or a glob in quotes."""
    out: Path
    """Folder for the denoised files; never the input's."""
    settings: OmitArgPrefixes[Options] = field(default_factory=Options)
    overwrite: bool = False
    """Start anew, whatever is in --out."""
    preview: bool = False
    """Also write preview.png and an animation: noisy | denoised | reference."""

    def run(self) -> None:
        from ..run.denoise import denoise
        from ..run.memory import keep_freed

        if self.preview:
            from ..run.preview import preview

        keep_freed()
        with progress_bar("denoising") as progress:
            task = progress.add_task("denoise", total=None)
            summary = denoise(
                self.source, self.out, self.settings, self.overwrite,
                lambda done, total: progress.update(task, completed=done, total=total),
            )  # fmt: skip
        print(f"{self.out}: {summary.written} frames written, {summary.skipped} were there")
        if summary.written:
            print(f"denoiser: {1000 * summary.seconds / summary.written:.0f} ms a frame")
        for what, count in summary.replaced.items():
            print(f"replaced: {what} in {count} pixels")
        for what, count in summary.left_out.items():
            if count:
                print(f"left out: {what} in {count} of {summary.written} frames")
        if summary.cuts:
            print(f"cuts: history starts anew at frame {', '.join(map(str, summary.cuts))}")
        if self.preview:
            from ..data.sequences import open_sequence

            o = self.settings
            sequence = open_sequence(
                self.source, signal=o.signal, preset=o.preset, layers=("reference",), allow_gaps=o.allow_gaps
            )
            print("preview:", ", ".join(str(path) for path in preview(sequence, self.out, o.layout, o.recombine)))


@dataclass(frozen=True)
class Inspect:
    """Print what a sequence holds: layers, preset, motion statistics, and whether its motion vectors follow the
    convention."""

    source: Positional[str]
    """Folder of EXR files, or a glob in quotes."""
    signal: str = "color"
    """'color' or 'indirect'."""
    preset: str = "auto"
    """Layout of the files: 'auto', 'native', 'cycles', 'mitsuba', 'falcor', 'bmfr', 'oidn', 'noisebase', or a .toml
    file."""
    allow_gaps: bool = False
    """Accept missing frame numbers."""

    def run(self) -> None:
        from ..run.inspect import inspect, render_text

        print(render_text(inspect(self.source, signal=self.signal, preset=self.preset, allow_gaps=self.allow_gaps)))


@dataclass(frozen=True)
class Demo:
    """Denoise the bundled sequence, print errors and times, and write pictures."""

    out: Path = Path("demo")
    """Folder for the pictures and numbers."""
    source: Path | None = None
    """Another sequence with reference."""
    signal: str = "indirect"
    """'color' or 'indirect'."""

    def run(self) -> None:
        from ..evaluate.demo import SAMPLE, demo

        demo(self.out, self.source or SAMPLE, self.signal)


Command = (
    Annotated[Denoise, tyro.conf.subcommand("denoise")]
    | Annotated[Inspect, tyro.conf.subcommand("inspect")]
    | Annotated[Render, tyro.conf.subcommand("render")]
    | Annotated[Clips, tyro.conf.subcommand("clips")]
    | Annotated[Clean, tyro.conf.subcommand("clean")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Demo, tyro.conf.subcommand("demo")]
)


def main(arguments: list[str] | None = None) -> None:
    """Entry point of `rtdenoise`. Exit codes: 0 done, 2 something is wrong with the input (one line on stderr), 130
    interrupted."""
    try:
        refuse_old_spelling(sys.argv[1:] if arguments is None else arguments)
        command = tyro.cli(
            Command, args=arguments, prog="rtdenoise", description="Real-time denoising of path-traced animations."
        )
        command.run()
    except InputError as error:
        print(f"rtdenoise: {error}", file=sys.stderr)
        sys.exit(2)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "torch":
            raise
        print("rtdenoise: this needs PyTorch, which is not installed; `denoise` alone does without it", file=sys.stderr)
        sys.exit(2)
    except OSError as error:  # a disk that is full, a folder that may not be written to
        print(f"rtdenoise: {error.filename or 'a file'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("rtdenoise: interrupted; run the same command again to go on", file=sys.stderr)
        sys.exit(130)
