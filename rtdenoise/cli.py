"""The command line. Every command is a dataclass whose comments are its help; what is wrong with the input is one line
and exit 2."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import OmitArgPrefixes, Positional

from .cli_evaluate import Evaluate, Report
from .denoise import Options
from .errors import InputError
from .progress import progress_bar
from .train_config import TrainConfig


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
        from .denoise import denoise
        from .memory import keep_freed

        if self.preview:
            from .preview import preview

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
                print(f"left out: {what} in {count} frames")
        if summary.cuts:
            print(f"cuts: history starts anew at frame {', '.join(map(str, summary.cuts))}")
        if self.preview:
            from .data.sequences import open_sequence

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
        from .inspect import inspect, render_text

        print(render_text(inspect(self.source, signal=self.signal, preset=self.preset, allow_gaps=self.allow_gaps)))


@dataclass(frozen=True)
class Render:
    """Render with Mitsuba 3: noisy frames, features, exact motion both ways, references; as EXR or training clips."""

    out: Path
    """Folder for the frames or clips; what is there already is kept."""
    scene: Positional[str] = "procedural"
    """'sample', 'procedural:SEED', 'wide:SEED', or a Mitsuba scene file (.xml)."""
    motion: Path | None = None
    """TOML file that moves camera and objects of a scene file."""
    clips: int = 0
    """Render this many training clips of procedural scenes instead, with the seeds --seed, --seed + 1 ..."""
    preset: Literal["", "train"] = ""
    """'train': the --clips are windows of the second, wider generator's scenes, chosen where something happens."""
    scenes: Path | None = None
    """With --preset train: folder of NAME/scene.xml; half of the scenes are drawn from these."""
    motions: Path | None = None
    """With --scenes: folder of NAME.toml, the motions of these scenes."""
    exclude: tuple[str, ...] = ("street", "dining-room")
    """With --scenes: names that are left out, to validate on."""
    textures: Path | None = None
    """With --preset train or wide:SEED: folder of PNG, JPEG or WebP pictures; some surfaces get them as textures."""
    reference_error: float = 0.01
    """With --preset train: relative squared error that the references may have; sets their samples, 32 to 512."""
    shard: str = "0/1"
    """With --preset train: 'i/n' renders the i-th of n equal parts of the set, counted from 0."""
    frames: int | None = None
    """Frames of the sequence, or of each clip (default: 12, clips 10)."""
    size: int | None = None
    """Pixels: width and height, unless those are given."""
    width: int | None = None
    """Pixels (default: 320, clips 128)."""
    height: int | None = None
    """Pixels (default: 180, clips 128)."""
    spp: int = 1
    """Samples per pixel of the noisy frames."""
    reference_spp: int | None = None
    """Samples per pixel of the references (default: 256; clips 64, more in noisier scenes, fewer in cleaner ones)."""
    max_depth: int = 6
    """Longest light path, in edges."""
    seed: int = 0
    """Of the noise; with --clips, of the first scene."""
    workers: int = 2
    """Processes that render clips."""

    def run(self) -> None:
        for name in ("frames", "width", "height", "size", "spp", "max_depth", "workers"):
            if (value := getattr(self, name)) is not None and value < 1:
                raise InputError(f"--{name.replace('_', '-')}: expected 1 or more, got {value}")
        if self.clips and self.reference_spp == 0:
            raise InputError("--reference-spp: clips are for training and need references; expected 2 or more, got 0")
        if self.preset != "train" and (self.scenes or self.shard != "0/1"):
            raise InputError("--scenes and --shard go with --preset train")
        if self.preset == "train":
            self._training_set()
        elif self.clips:
            if self.textures:
                raise InputError("--textures goes with wide:SEED and --preset train; --clips alone draws as ever")
            from .render.clips import ClipOptions, render_clips

            size = (self.height or self.size or 128, self.width or self.size or 128)
            render_clips(
                self.out,
                ClipOptions(
                    self.clips, size, self.frames or 10, self.seed, self.spp, self.reference_spp or 64, self.max_depth,
                    self.workers,
                ),
            )  # fmt: skip
        else:
            from .render.draw import open_scene
            from .render.frames import RenderOptions, render_sequence

            size = (self.height or self.size or 180, self.width or self.size or 320)
            spp = 256 if self.reference_spp is None else self.reference_spp
            options = RenderOptions(size, self.spp, spp, self.max_depth, self.seed)
            render_sequence(open_scene(self.scene, self.motion, self.textures), self.out, self.frames or 12, options)

    def _training_set(self) -> None:
        from .render.training_set import SetOptions, find_scenes, parse_shard, render_set

        if self.reference_spp is not None or self.motion:
            raise InputError("--preset train takes --reference-error and --motions, not --reference-spp and --motion")
        size = (self.height or self.size or 128, self.width or self.size or 128)
        options = SetOptions(
            self.clips or 300, size, self.frames or 10, self.seed, self.spp, self.reference_error,
            max_depth=self.max_depth, workers=self.workers, shard=parse_shard(self.shard),
            scenes=find_scenes(self.scenes, self.motions, self.exclude) if self.scenes else (),
            textures=str(self.textures or ""),
        )  # fmt: skip
        with progress_bar("rendering") as bar:
            task = bar.add_task("render", total=None)

            def report(done: int, total: int, line: str) -> None:
                bar.update(task, completed=done, total=total)
                bar.console.print(line, highlight=False, soft_wrap=True)

            card = render_set(self.out, options, report)
        print(f"{self.out}: {card['clips']} clips; DATA.md says what they are")


@dataclass(frozen=True)
class Train:
    """Train a model on rendered clips; a run directory that is there is resumed."""

    config: OmitArgPrefixes[TrainConfig]

    def run(self) -> None:
        from .train import train

        print(f"weights: {train(self.config)}")


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
        from .demo import SAMPLE, demo

        demo(self.out, self.source or SAMPLE, self.signal)


Command = (
    Annotated[Denoise, tyro.conf.subcommand("denoise")]
    | Annotated[Inspect, tyro.conf.subcommand("inspect")]
    | Annotated[Render, tyro.conf.subcommand("render")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Demo, tyro.conf.subcommand("demo")]
)


def main(arguments: list[str] | None = None) -> None:
    """Entry point of `rtdenoise`. Exit codes: 0 done, 2 something is wrong with the input (one line on stderr), 130
    interrupted."""
    command = tyro.cli(
        Command, args=arguments, prog="rtdenoise", description="Real-time denoising of path-traced animations."
    )
    try:
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
