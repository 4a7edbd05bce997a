"""A sequence of files as frames: pixels are read when they are asked for (`opening.open_sequence`)."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import overload

import numpy as np

from ..errors import InputError
from ..frame import CHANNELS, Frame
from .components import check_components
from .exr_format import ExrHeader
from .files import FrameFiles, find_gaps
from .fog import with_fog
from .layers import SIGNALS
from .layout import SCALES, Layout, Rule, pixels
from .lost import with_lost_samples
from .panorama import Panorama
from .region import Region
from .scene_motion import complete
from .shutter import Surfaces
from .sky import without_stale_sky
from .soft_edges import with_soft_edges
from .veiled import with_veiled
from .virtual_motion import with_virtual_motion

MOVED = "albedo", "normal", "depth", "motion", "motion_next"  # what virtual motion takes
DEFAULT_LAYERS = ("radiance", *MOVED)


@dataclass(frozen=True)
class Sequence:
    """Frames in order of their numbers: `len(s)`, `s[i]`, `for frame in s`; `s[:10]` is a sequence of its own. Every
    access reads the file anew.

    Layers that the files lack are None in the frames. Exceptions are `motion` and `motion_next`, which are computed
    where `position`, `id` and a `scene.json` allow it.
    """

    files: tuple[FrameFiles, ...]  # of each frame, their numbers ascending
    size: tuple[int, int]  # (H, W)
    signal: str
    layout: Layout  # of the files
    header: ExrHeader = field(repr=False)  # of the first file
    rules: dict[str, Rule]  # layer of `Frame` -> the channels that it is read from; only those that are read
    available: dict[str, Rule] = field(repr=False)  # as `rules`, for everything that could be read
    gaps: tuple[tuple[int, int], ...] = ()  # (first, last) missing frame number of each gap
    scene: dict | None = field(default=None, repr=False)  # cameras and transforms beside the frames, as in scene.json
    soft_edges: bool = False  # frames are read `with_soft_edges`, for denoisers
    virtual_motion: bool = False  # frames are read `with_virtual_motion` where files hold the length of paths
    fog: bool = False  # frames are read `with_fog` where files hold the light of volumes
    few_samples: bool = False  # in which albedo is noise, too
    lost_samples: bool = False  # frames are read `with_lost_samples`
    veiled: bool = False  # frames are read `with_veiled`
    surfaces: Surfaces | None = field(default=None, repr=False)  # without motion blur: layers that these give
    beyond: Region | Panorama | None = None  # frames are read with what continues them beyond what was rendered

    @property
    def numbers(self) -> tuple[int, ...]:
        """Frame numbers, ascending."""
        return tuple(files.number for files in self.files)

    @property
    def paths(self) -> tuple[Path, ...]:
        """The file of each frame that holds the signal."""
        channel = self.rules["radiance"].channels[0]
        return tuple(next(iter(files.locate([channel]))) for files in self.files)

    @property
    def names(self) -> tuple[str, ...]:
        """The file name of each frame's output."""
        return tuple(files.output_name(path) for files, path in zip(self.files, self.paths, strict=True))

    @property
    def read_size(self) -> tuple[int, int]:
        """(H, W) of frames as they are read."""
        return self.beyond.size(*self.size) if self.beyond else self.size

    @property
    def demodulated(self) -> bool:
        """Whether the renderer has already divided the signal by the albedo."""
        return self.signal in self.layout.demodulated

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[Frame]:
        return (self[i] for i in range(len(self)))

    @overload
    def __getitem__(self, i: int) -> Frame: ...

    @overload
    def __getitem__(self, i: slice) -> Sequence: ...

    def __getitem__(self, i):
        """Frame i (not the frame with the number i): `[1, C, H, W]` float32 tensors. Of a slice the sequence of these
        frames, with `gaps` where some are left out. Raises InputError for one that goes backwards.

        Values are as stored, non-finite ones too, except that the depth of misses (inf, Cycles' 1e10) becomes 0.
        """
        if isinstance(i, slice):
            if (i.step or 1) < 0:
                raise InputError(f"a sequence has its frames in order of their numbers, got a step of {i.step}; take "
                                 "reversed(sequence) for its frames backwards")  # fmt: skip
            files = self.files[i]
            return replace(self, files=files, gaps=find_gaps(files))
        import torch

        return self.read(i).map(torch.from_numpy)

    def read(self, i: int) -> Frame:
        """`self[i]` with numpy arrays, without torch."""
        files = self.files[i]
        rules, (path, fog) = self.rules, self.besides(files)
        lost = self.lost_samples and "albedo" in self.rules
        veiled = self.veiled and not self.rules.keys().isdisjoint(MOVED)
        # Whatever is wanted of the frame, it is the same.
        needed = MOVED if path or fog or veiled else ("depth",) if lost else ()
        rules = rules | {layer: self.available[layer] for layer in needed if layer in self.available}
        read = *rules.values(), *([path] if path else ()), *fog.values()
        channels = self.planes(i, {name for rule in read for name in rule.channels})
        layers = {layer: convert(rule, channels, layer, self.size) for layer, rule in rules.items()}
        more = self.layout.more_history
        frame = Frame(**layers, number=files.number, name=str(files.path), more_history=more)
        frame = self.beyond.joined(frame) if self.beyond else frame
        if veiled:
            frame = with_veiled(frame)
        if self.layout.name == "cycles":
            frame = without_stale_sky(frame)
        if path:
            frame = with_virtual_motion(frame, convert(path, channels, "path"))
        if fog:
            light = {name: convert(rule, channels, name) for name, rule in fog.items()}
            sky = light.pop("sky", None)
            frame = with_fog(frame, sum(light.values()), sky, self.few_samples)
        if lost:
            frame = with_lost_samples(frame)
        frame = replace(frame, **dict.fromkeys(rules.keys() - self.rules.keys()))
        if self.soft_edges:
            frame = with_soft_edges(frame)
        check_components(frame)
        missing = [layer for layer in ("depth", "motion", "motion_next") if getattr(frame, layer) is None]
        frame = complete(frame, self.scene) if missing and self.scene else frame
        return self.surfaces.give(frame) if self.surfaces else frame

    def planes(self, i: int, names: Collection[str]) -> dict[str, np.ndarray]:
        """Channels of frame i, float32, as stored where it was rendered: `[H, W]` of `read_size`."""
        return {name: self.around(plane) for name, plane in self.files[i].read(names).items()}

    def around(self, plane: np.ndarray) -> np.ndarray:
        """A channel `[H, W]` as it is stored, with what continues it: of `read_size`."""
        return self.beyond.around(plane) if self.beyond else plane

    def within(self, image: np.ndarray) -> np.ndarray:
        """The inverse of `around`, of an image `[…, H, W]` of `read_size`."""
        return self.beyond.within(image) if self.beyond else image

    def besides(self, files: FrameFiles) -> tuple[Rule | None, dict[str, Rule]]:
        """What is read of a frame beside its layers: the path length for virtual motion, None without; and the light of
        volumes and of the sky for fog, none without. Neither where nothing that it changes is read, nor where it is
        missing, or what goes with it."""
        path = self.layout.path if self.virtual_motion and self.available.keys() >= {*MOVED} - {"motion_next"} else None
        fog = self.layout.fog if self.fog and "depth" in self.available else {}
        if self.rules.keys().isdisjoint({"albedo", "motion", "motion_next"}):
            path = None
        if self.rules.keys().isdisjoint(MOVED) or not (path or fog):
            return None, {}
        names = files.header().channels.keys()
        found = {light: m for light, rules in fog.items() for m in [rule.match(names) for rule in rules] if m}
        path = path if path and names >= {*path.channels} else None
        return path, found if found.keys() - {"sky"} else {}

    def only(self, layers: Collection[str] | str) -> Sequence:
        """The sequence with only these layers of `Frame` and the layers that they are computed from.

        Parts of a multi-part file that nothing needs are not even read from the disk. Raises InputError as
        `layer_names`.
        """
        layers = layer_names(layers)
        computed = [layer for layer in layers if layer in DEFAULT_LAYERS and layer not in self.available]
        wanted = {*layers, *(("position", "id") if computed else ())}
        rules = {layer: rule for layer, rule in self.rules.items() if layer in wanted}
        return replace(self, rules=rules, surfaces=self.surfaces and self.surfaces.only(wanted))

    def require(self, *layers: str) -> Sequence:
        """The sequence itself, if it has these layers of `Frame`.

        Raises `InputError` naming the file, the first missing layer, the channels there are, and the remedy, and as
        `layer_names`.
        """
        if missing := [layer for layer in layer_names(layers) if not self.has(layer)]:
            raise InputError(no_layer(self.header, self.layout, self.signal, missing[0]))
        return self

    def require_channels(self, names: Collection[str], what: str) -> None:
        """Raise `InputError` where a later frame lacks channels of the first, which `what` needs."""
        for files in self.files[1:] if names else ():
            header = files.header()
            if missing := [name for name in names if name not in header.channels]:
                raise InputError(f"{header.path}: lacks channel {missing[0]}, which {self.paths[0].name} has and "
                                 f"{what} needs; the file has {header.summary}")  # fmt: skip

    def has(self, layer: str) -> bool:
        """Whether its frames have a layer of `Frame`: the files have it, or what it is computed from, or `surfaces`."""
        if self.surfaces and (given := self.surfaces.has(layer)) is not None:
            return given
        if layer in self.available or not self.scene or "position" not in self.available:
            return layer in self.available
        return layer in ("depth", "motion", "motion_next") and ("id" in self.available or not self.scene["objects"])


def layer_names(layers: Collection[str] | str) -> tuple[str, ...]:
    """Names of layers of `Frame`; a plain string is one. Raises InputError for a name that is none."""
    names = (layers,) if isinstance(layers, str) else (*layers,)
    if unknown := [name for name in names if name not in CHANNELS]:
        raise InputError(f"unknown layer '{unknown[0]}': known are {', '.join(CHANNELS)}")
    return names


def convert(
    rule: Rule,
    channels: dict[str, np.ndarray],  # [H, W] each
    layer: str,
    picture: tuple[int, int] | None = None,  # its (H, W), where channels hold more: motion may be a part of it
) -> np.ndarray:
    """A layer `[1, C, H, W]` from channels, in the conventions of `frame.py`."""
    stored = [channels[name] for name in rule.channels]
    image = np.empty((len(stored), *stored[0].shape), np.float32)
    for plane, channel, sign in zip(image, stored, rule.signs, strict=True):
        np.subtract(channel, rule.offset, out=plane)
        if sign != 1:
            plane *= sign
    if layer == "depth":
        image[np.abs(image) >= rule.miss] = 0
    if layer == "normal" and rule.offset:  # black, which is no direction, is written where nothing was hit
        image = np.where(np.any(stored, axis=0), image, np.float32(0))
    if rule.scale in SCALES:
        image = image * np.array(pixels(rule.scale, picture or image.shape[1:]), np.float32).reshape(2, 1, 1)
    elif rule.scale != 1:
        image = image * np.float32(rule.scale)
    return image[None]


def no_layer(header: ExrHeader, layout: Layout, signal: str, layer: str) -> str:
    """What to tell of files without a layer of `Frame`: the channels that there are, and the remedy."""
    label = f"signal '{signal}'" if layer == "radiance" else f"layer '{layer}'"
    others = [s for s in SIGNALS if layer == "radiance" and "radiance" in layout.resolve(header, s)]
    advice = f"choose the signal '{others[0]}', which is there, or " if others else ""
    found = f"no {label} ({layout.name} layout); the file has {header.summary}"
    return f"{header.path}: {found}; {advice}{layout.hint(layer, signal)}"
