"""The commands that make data and weights: `render`, `clean` and `train`; what they need is imported when they run."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

from tyro.conf import OmitArgPrefixes, Positional

from ..errors import InputError
from ..training.config import TrainConfig
from .progress import progress_bar

# Options that go with --preset train.
OF_SETS = {"scenes", "motions", "exclude", "generator", "sun", "calm", "reference_error", "shard"}


@dataclass(frozen=True)
class Render:
    """Render with Mitsuba 3: noisy frames, features, exact motion both ways, references; as EXR or training clips."""

    out: Path
    """Folder for the frames or clips; what is there already is kept."""
    scene: Positional[str] = ""
    """'sample', 'procedural:SEED', 'wide:SEED', 'sunlit:SEED', or a Mitsuba scene file (.xml)."""
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
    exclude: tuple[str, ...] = ("street", "dining-room", "staircase2", "bathroom")
    """With --scenes: names that are left out, to validate on."""
    generator: Literal[2, 3] = 3
    """With --preset train: version of the generator; 2 is that of the shipped weights' older sets."""
    sun: float = 0.0
    """With --preset train: share of the generated scenes that a sun shines on, with sharp shadows (0 to 1)."""
    calm: float = 0.0
    """With --preset train: share of the scenes in which nothing but the camera moves, slowly where they are generated
    (0 to 1)."""
    textures: Path | None = None
    """With --preset train or wide:SEED: folder of PNG, JPEG or WebP pictures; some surfaces get them as textures."""
    reference_error: float = 0.01
    """With --preset train: relative squared error that references of beauty may have; sets their samples, 32 to 512."""
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
        for name in ("sun", "calm"):
            if not 0 <= (share := getattr(self, name)) <= 1:
                raise InputError(f"--{name}: expected a share from 0 to 1, got {share}")
        if not self.reference_error > 0:
            raise InputError(f"--reference-error: expected more than 0, got {self.reference_error}")
        self._refuse_what_would_be_left_aside()
        if self.preset == "train":
            self._training_set()
        elif self.clips:
            from ..render.clips import ClipOptions, render_clips

            size = (self.height or self.size or 128, self.width or self.size or 128)
            render_clips(
                self.out,
                ClipOptions(
                    self.clips, size, self.frames or 10, self.seed, self.spp, self.reference_spp or 64, self.max_depth,
                    self.workers,
                ),
            )  # fmt: skip
        else:
            from ..render.draw import open_scene
            from ..render.frames import RenderOptions, render_sequence

            size = (self.height or self.size or 180, self.width or self.size or 320)
            spp = 256 if self.reference_spp is None else self.reference_spp
            options = RenderOptions(size, self.spp, spp, self.max_depth, self.seed)
            render_sequence(open_scene(self.scene, self.motion, self.textures), self.out, self.frames or 12, options)

    def _refuse_what_would_be_left_aside(self) -> None:
        """Raises InputError for options that this kind of rendering does not take, and where there is nothing to do."""
        given = {option.name for option in fields(self) if getattr(self, option.name) != option.default}
        if self.preset != "train" and (stray := given & OF_SETS):
            raise InputError(f"--{min(stray).replace('_', '-')}: goes with --preset train")
        if (self.preset or self.clips) and (stray := given & {"scene", "motion"}):
            raise InputError(f"{min(stray)}: is for one sequence; clips are of generated scenes, and of --scenes")
        if self.preset == "train" and self.reference_spp is not None:
            raise InputError("--preset train takes --reference-error, not --reference-spp")
        if self.clips and self.preset != "train" and self.textures:
            raise InputError("--textures goes with wide:SEED and --preset train; --clips alone draws as ever")
        if not (self.preset or self.clips or self.scene):
            raise InputError("nothing to render: name a scene, or ask for --clips")

    def _training_set(self) -> None:
        from ..render.training_set import SetOptions, find_scenes, parse_shard, render_set

        size = (self.height or self.size or 128, self.width or self.size or 128)
        options = SetOptions(
            self.clips or 300, size, self.frames or 10, self.seed, self.spp, self.reference_error,
            max_depth=self.max_depth, workers=self.workers, shard=parse_shard(self.shard),
            scenes=find_scenes(self.scenes, self.motions, self.exclude) if self.scenes else (),
            generator=self.generator, sun=self.sun, calm=self.calm, textures=str(self.textures or ""),
        )  # fmt: skip
        with progress_bar("rendering") as bar:
            task = bar.add_task("render", total=None)

            def report(done: int, total: int, line: str) -> None:
                bar.update(task, completed=done, total=total)
                bar.console.print(line, highlight=False, soft_wrap=True)

            card = render_set(self.out, options, report)
        print(f"{self.out}: {card['clips']} clips; DATA.md says what they are")


@dataclass(frozen=True)
class Clean:
    """Write training clips again with their references denoised by OIDN: for training, not for validation."""

    folder: Positional[Path]
    """Folder of clips."""
    out: Path
    """Folder for the same clips; those that are there are kept."""

    def run(self) -> None:
        from ..training.clean import clean

        with progress_bar("cleaning") as bar:
            task = bar.add_task("clean", total=None)
            count = clean(self.folder, self.out, lambda done, total: bar.update(task, completed=done, total=total))
        print(f"{self.out}: {count} clips written")


@dataclass(frozen=True)
class Train:
    """Train a model on rendered clips; a run directory that is there is resumed."""

    config: OmitArgPrefixes[TrainConfig]

    def run(self) -> None:
        from rich.progress import TextColumn

        from ..training.loop import train

        with progress_bar("training", TextColumn("{task.fields[loss]}")) as bar:
            task = bar.add_task(
                "train", total=None, loss="", visible=False
            )  # of torchrun's processes one alone shows it

            def on_step(step: int, steps: int, loss: float) -> None:
                bar.update(
                    task, visible=True, completed=step, total=steps, loss="" if math.isnan(loss) else f"loss {loss:.4f}"
                )

            weights = train(self.config, on_step)
        print(f"weights: {weights}")
