"""`rtdenoise render`: one sequence of EXR files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from reprlib import repr as shown
from typing import Annotated

from tyro.conf import Positional, arg

from ..errors import InputError

MOST = {  # of the options that count something; more is a slip, or more than the renderer takes
    "frames": 1_000_000, "width": 65_536, "height": 65_536, "size": 65_536, "spp": 1 << 24, "reference_spp": 1 << 24,
    "max_depth": 10_000, "count": 10_000_000, "workers": 1024,
}  # fmt: skip
MAX_PATHS = 2**32 - 1  # of one frame: samples are numbered by 32 bits


@dataclass(frozen=True)
class Render:
    """Render one sequence with Mitsuba 3: noisy frames, features, exact motion both ways, references."""

    out: Path
    """Folder for the frames; existing ones are kept."""
    scene: Annotated[Positional[str], arg(metavar="SCENE", help_behavior_hint="(required)")] = ""
    """'sample', 'procedural:SEED', 'wide:SEED', 'sunlit:SEED', or a Mitsuba scene file (.xml)."""
    motion: Path | None = None
    """TOML file that moves camera and objects of a scene file."""
    textures: Path | None = None
    """With wide:SEED: folder of PNG, JPEG or WebP pictures that some surfaces get as textures."""
    frames: int = 12
    """Frames of the sequence."""
    size: int | None = None
    """Pixels: width and height, unless those are given."""
    width: int | None = None
    """Pixels (default: 320)."""
    height: int | None = None
    """Pixels (default: 180)."""
    spp: int = 1
    """Samples per pixel of the noisy frames."""
    reference_spp: int = 256
    """Samples per pixel of the references; 0: no references."""
    max_depth: int = 6
    """Longest light path, in edges."""
    seed: int = 0
    """Of the noise; scenes have seeds of their own."""

    def run(self) -> None:
        if not self.scene:
            raise InputError("nothing to render: name a scene; training sets are rendered by `rtdenoise clips`")
        at_least_one(self, "frames", "width", "height", "size", "spp", "max_depth")
        not_negative(self, "reference_spp", "seed")
        from ..render.frames import RenderOptions
        from ..render.scenes.named import open_scene
        from ..render.sequence import render_sequence

        size = (self.height or self.size or 180, self.width or self.size or 320)
        if (paths := size[0] * size[1] * self.spp) > MAX_PATHS:
            raise InputError(f"--spp {self.spp}: {size[1]}×{size[0]} pixels take {paths} paths a frame, expected "
                             f"{MAX_PATHS} at most; average several runs with other --seed")  # fmt: skip
        options = RenderOptions(size, self.spp, self.reference_spp, self.max_depth, self.seed)
        render_sequence(open_scene(self.scene, self.motion, self.textures), self.out, self.frames, options)


def at_least_one(command: object, *names: str) -> None:
    """Raise InputError where one of these options is given and below 1, or above its limit in `MOST`."""
    _within(1, command, names)


def not_negative(command: object, *names: str) -> None:
    """Raise InputError where one of these options is given and below 0, or above its limit in `MOST`."""
    _within(0, command, names)


def _within(least: int, command: object, names: tuple[str, ...]) -> None:
    for name in names:
        value, option, most = getattr(command, name), f"--{name.replace('_', '-')}", MOST.get(name)
        if value is not None and value < least:
            raise InputError(f"{option}: expected {least} or more, got {value}")
        if value is not None and most is not None and value > most:
            raise InputError(f"{option}: expected {most} at most, got {shown(value)}")
