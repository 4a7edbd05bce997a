"""`rtdenoise render`: one sequence of EXR files."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from reprlib import repr as shown
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..errors import InputError

MOST = {  # of the options that count something; more is a slip, or more than the renderer takes
    "frames": 1_000_000, "width": 65_536, "height": 65_536, "size": 65_536, "spp": 1 << 24, "reference_spp": 1 << 24,
    "max_depth": 10_000, "count": 10_000_000, "workers": 1024, "lead_in": 1_000_000,
}  # fmt: skip
MAX_PATHS = 2**32 - 1  # of one frame: samples are numbered by 32 bits


@dataclass(frozen=True)
class Render:
    """Render one sequence with Mitsuba 3: noisy frames, features, exact motion both ways, references."""

    out: Path
    """Folder for the frames; existing ones are kept."""
    scene: Annotated[Positional[str], arg(metavar="SCENE", help_behavior_hint="(required)")] = ""
    """'sample', 'procedural:SEED', 'wide:SEED', 'sunlit:SEED', 'caustic:SEED', or a Mitsuba scene file (.xml)."""
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
    window: Annotated[
        tuple[int, int, int, int] | None,
        arg(metavar="LEFT TOP WIDTH HEIGHT", help_behavior_hint="(default: the whole picture)"),
    ] = None
    """Part of the picture, in pixels: frames show it alone, at the sharpness of the whole picture."""
    spp: int = 1
    """Samples per pixel of the noisy frames; with pssmlt, mutations."""
    reference_spp: int = 256
    """Samples per pixel of the references, half of them in each of two halves: an even number; 0: no references."""
    max_depth: int | None = None
    """Longest light path, in edges (default: 6, for caustic:SEED 8)."""
    seed: int = 0
    """Of the noise; scenes have seeds of their own."""
    integrator: Literal["path", "pssmlt"] = "path"
    """pssmlt: Metropolis sampling, which finds caustics; adds the layers large, small and proposals."""
    chains: int | None = None
    """With pssmlt: chains in parallel (default: one for every 4 pixels, at most 65536); fewer are longer."""
    mlt_seed: Literal["frame", "same"] = "frame"
    """With pssmlt: random numbers of the noisy frames, others for each or the same for all."""
    attribution: Literal["made", "replaced"] = "made"
    """With pssmlt: a state's light counts as large or small by the step that made it, or that replaced it."""
    references: Literal["pssmlt", "path"] = "pssmlt"
    """With pssmlt: how references are rendered; path where there are no caustics."""

    def run(self) -> None:
        if not self.scene:
            raise InputError("nothing to render: name a scene; training sets are rendered by `rtdenoise clips`")
        at_least_one(self, "frames", "width", "height", "size", "spp", "max_depth", "chains")
        not_negative(self, "reference_spp", "seed")
        refuse_odd_references(self.reference_spp)
        from ..render.frames import RenderOptions
        from ..render.scenes.caustic import CAUSTIC_DEPTH
        from ..render.scenes.named import open_scene
        from ..render.sequence import render_sequence

        view = (self.height or self.size or 180, self.width or self.size or 320)
        size = self._window(view) if self.window else view
        refuse_too_many_paths(size, self.spp)
        depth = self.max_depth or (CAUSTIC_DEPTH if self.scene.startswith("caustic:") else 6)
        options = RenderOptions(size, self.spp, self.reference_spp, depth, self.seed, self._metropolis(size))
        scene = open_scene(self.scene, self.motion, self.textures)
        if self.window:
            scene = scene.seen_through((*view, self.window[1], self.window[0]))
        render_sequence(scene, self.out, self.frames, options)

    def _window(self, view: tuple[int, int]) -> tuple[int, int]:
        """Height and width of the window in a picture of `view` (height, width). Raises InputError where it leaves
        the picture."""
        (left, top, width, height), (below, right) = self.window, view
        if not (0 <= left < left + width <= right and 0 <= top < top + height <= below):
            raise InputError(f"--window {' '.join(map(str, self.window))}: expected LEFT TOP WIDTH HEIGHT, a part of "
                             f"{right}×{below} pixels")  # fmt: skip
        return height, width

    def _metropolis(self, size: tuple[int, int]):
        """Options of Metropolis sampling; None for path tracing. Raises InputError for options that do not apply."""
        from ..render.metropolis import MetropolisOptions, chains_of

        if self.integrator == "path":
            defaults = {option.name: option.default for option in fields(self)}
            for name in ("chains", "mlt_seed", "attribution", "references"):
                if getattr(self, name) != defaults[name]:
                    raise InputError(f"--{name.replace('_', '-')}: goes with --integrator pssmlt")
            return None
        options = MetropolisOptions(self.chains or 0, self.mlt_seed, self.attribution, self.references)
        chains_of(options, size, self.spp)
        return options


def at_least_one(command: object, *names: str) -> None:
    """Raise InputError where one of these options is given and below 1, or above its limit in `MOST`."""
    _within(1, command, names)


def not_negative(command: object, *names: str) -> None:
    """Raise InputError where one of these options is given and below 0, or above its limit in `MOST`."""
    _within(0, command, names)


def refuse_odd_references(reference_spp: int | None) -> None:
    """Raise InputError for a number of samples that two halves cannot share."""
    if reference_spp and reference_spp % 2:
        raise InputError(f"--reference-spp: references are rendered in two halves; expected an even number, got "
                         f"{reference_spp}")  # fmt: skip


def refuse_too_many_paths(size: tuple[int, int], spp: int) -> None:
    """Raise InputError where a frame of `size` (height, width) takes more than `MAX_PATHS`."""
    if (paths := size[0] * size[1] * spp) > MAX_PATHS:
        raise InputError(f"--spp {spp}: {size[1]}×{size[0]} pixels take {paths} paths a frame, expected "
                         f"{MAX_PATHS} at most; average several runs with other --seed")  # fmt: skip


def _within(least: int, command: object, names: tuple[str, ...]) -> None:
    for name in names:
        value, option, most = getattr(command, name), f"--{name.replace('_', '-')}", MOST.get(name)
        if value is not None and value < least:
            raise InputError(f"{option}: expected {least} or more, got {value}")
        if value is not None and most is not None and value > most:
            raise InputError(f"{option}: expected {most} at most, got {shown(value)}")
