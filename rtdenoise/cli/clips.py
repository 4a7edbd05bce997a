"""`rtdenoise clips`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..errors import InputError
from .progress import progress_bar


@dataclass(frozen=True)
class Clips:
    """Render training clips with Mitsuba 3: windows of generated scenes and of scene files."""

    out: Path
    """Folder for the clips; clips that it holds already are kept."""
    count: int = 300
    """Number of clips."""
    scenes: Path | None = None
    """Folder of NAME/scene.xml; half of the clips show these scenes."""
    motions: Path | None = None
    """With --scenes: folder of NAME.toml, the motions of these scenes."""
    exclude: tuple[str, ...] = ("street", "dining-room", "staircase2", "bathroom")
    """With --scenes: names that are left out, to validate on."""
    generator: Literal[2, 3] = 3
    """Version of the scene generator."""
    sun: float = 0.0
    """Share of the generated scenes that a sun shines on, with sharp shadows (0 to 1)."""
    calm: float = 0.0
    """Share of the scenes in which only the camera moves (0 to 1)."""
    textures: Path | None = None
    """Folder of PNG, JPEG or WebP pictures; some surfaces get them as textures."""
    reference_error: float = 0.01
    """Relative squared error that references of beauty may have."""
    shard: str = "0/1"
    """'i/n' renders the i-th of n equal parts of the set, counted from 0."""
    frames: int = 10
    """Frames of each clip."""
    size: int = 128
    """Width and height in pixels."""
    spp: int = 1
    """Samples per pixel of the noisy frames."""
    max_depth: int = 6
    """Longest light path, in edges."""
    seed: int = 0
    """Of the first scene."""
    workers: int = 2
    """Processes."""

    def run(self) -> None:
        for name in ("count", "frames", "size", "spp", "max_depth", "workers"):
            if (value := getattr(self, name)) < 1:
                raise InputError(f"--{name.replace('_', '-')}: expected 1 or more, got {value}")
        from ..render.training_set import SetOptions, find_scenes, parse_shard, render_set

        options = SetOptions(
            self.count, (self.size, self.size), self.frames, self.seed, self.spp, self.reference_error,
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
