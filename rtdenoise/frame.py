"""The named buffers of a frame, the state between frames, and their conventions.

Conventions (stated here once; every other module refers to this page)
----------------------------------------------------------------------
Images      tensors `[B, C, H, W]`, float32 unless said. Row 0 on top, x right, y down, pixel centres at +0.5.
Radiance    linear, scene-referred, unbounded HDR.
Albedo      in [0, 1]. Normals in world space, in [-1, 1], not half-encoded.
Depth       linear distance from the camera, > 0; 0 (or inf) where nothing was hit.
motion      `[B, 2, H, W]` = (x, y) in pixels, previous minus current: the surface that is at pixel p now was at
            `p + motion(p)` in the previous frame.
motion_next next minus current: the surface that is at p now will be at `p + motion_next(p)` in the next frame.
id          integer per object; 0 where nothing was hit. Stable over a sequence.

A *signal* is the light to denoise: `color` (the beauty) or `indirect` (light that bounced at least once on its way).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

OFF_SCREEN = 1e4  # pixels: the motion of a point that is not on the other frame; half floats can hold it
# A frame belongs to another shot where a larger share of its pixels finds another surface in history
# (`history.mismatch`). Measured (bench/calibration/cuts.py): the smallest share without a false alarm, so it misses the
# fewest cuts.
MAX_CUT_MISMATCH = 0.3
# Pixels. A pixel counts as uncovered where dual and traditional motion differ by more. Elsewhere they differ because
# motion_next is fetched at the nearest pixel: by half a pixel times the motion's gradient at most. Measured
# (bench/calibration/occlusion_threshold.py): at 0.5, 98 % of the marked pixels were hidden before; a lower threshold
# soon marks more noise than occlusions, a higher one gains little.
OCCLUSION_THRESHOLD = 0.5
HIDDEN = "hidden."  # prefix of the names of hidden features in `History.layers`
RECENT = "recent."  # likewise of recent frames
SHIFTS = "shifts."  # likewise of shifts
SEVERAL = HIDDEN, RECENT, SHIFTS
CHANNELS = {
    "radiance": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2, "motion_next": 2,
    "position": 3, "id": 1, "samples": 1, "components": None, "reference": 3, "reference_half": 3,
}  # fmt: skip
"""Layer -> channels; None: any multiple of three."""


@dataclass(frozen=True)
class Frame:
    """The buffers of one frame: float32 tensors, or numpy arrays for `rtdenoise.glsl`. None: the frame lacks the layer.

    radiance          [B, 3, H, W]  the noisy signal: linear, scene-referred, ≥ 0, unbounded
    albedo            [B, 3, H, W]  in [0, 1]
    normal            [B, 3, H, W]  world space, in [-1, 1]
    depth             [B, 1, H, W]  linear distance from the camera, > 0; 0 or inf where nothing was hit
    motion            [B, 2, H, W]  (x, y) in pixels, previous minus current; x right, y down
    motion_next       [B, 2, H, W]  (x, y) in pixels, next minus current
    position          [B, 3, H, W]  world space
    id                [B, 1, H, W]  number of the object, 0 where nothing was hit
    samples           [B, 1, H, W]  samples a pixel of the noisy signal
    components        [B, 3K, H, W] the noisy signal split into K parts that add up to it
    reference         [B, 3, H, W]  the converged signal, for training and evaluation only
    reference_half    [B, 3, H, W]  the mean of one half of the reference's samples
    number, name      the frame's number, and its origin for messages
    more_history      whether networks for many samples take more history, as of frames of Cycles (docs/notes/many.md)

    `step` needs radiance, albedo, normal, depth and, with a history, motion. Arrays `[H, W, C]` go into
    `rtdenoise.Denoiser` instead. Raises InputError where radiance has no four axes, ValueError where another layer does
    not fit it.
    """

    radiance: Tensor
    albedo: Tensor | None = None
    normal: Tensor | None = None
    depth: Tensor | None = None
    motion: Tensor | None = None
    motion_next: Tensor | None = None
    position: Tensor | None = None
    id: Tensor | None = None
    samples: Tensor | None = None
    components: Tensor | None = None
    reference: Tensor | None = None
    reference_half: Tensor | None = None
    number: int = 0
    name: str = ""
    more_history: bool = False

    def __post_init__(self) -> None:
        shape = tuple(getattr(self.radiance, "shape", ()))
        if len(shape) != 4:
            found = shape or type(self.radiance).__name__
            advice = "rtdenoise.Denoiser takes [H, W, 3]"
            raise InputError(f"{self.name or 'frame'}: expected radiance [B, 3, H, W], got {found}; {advice}")
        size = (self.radiance.shape[0], *self.radiance.shape[2:])
        for layer, tensor in self.layers():
            channels, found = CHANNELS[layer], tuple(tensor.shape)
            if channels is None and len(found) == 4 and found[1] % 3 == 0:
                channels = found[1]
            if found != (size[0], channels, *size[1:]):
                expected = (size[0], channels or "3K", *size[1:])
                raise ValueError(f"{self.name or 'frame'}: expected {layer} {expected}, got {found}")

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)."""
        return self.radiance.shape[2], self.radiance.shape[3]

    def divided(self, gain: Tensor | np.ndarray | float) -> Frame:
        """The frame with its light, and the parts of it, over `gain`, `[B, 1, 1, 1]` or one number."""
        import numpy as np

        with np.errstate(over="ignore"):  # arrays may hold values that no filter can use, which are replaced later
            parts = None if self.components is None else self.components / gain
            return replace(self, radiance=self.radiance / gain, components=parts)

    def with_samples(self, count: int) -> Frame:
        """The frame with `count` samples a pixel; itself where it has `samples` already or `count` is 0: unknown."""
        if not count or self.samples is not None:
            return self
        shape = (len(self.radiance), 1, *self.size)
        if hasattr(self.radiance, "new_full"):
            return replace(self, samples=self.radiance.new_full(shape, count))
        import numpy as np

        return replace(self, samples=np.full(shape, count, self.radiance.dtype))

    def require(self, *layers: str, previous: Tensor | None = None) -> None:
        """Raise InputError where one of `layers` is missing, or `previous` (a history's image) is of another size."""
        for layer in layers:
            if getattr(self, layer) is None:
                raise InputError(f"{self.name or 'frame'}: layer {layer} is missing; needed are {', '.join(layers)}")
        if previous is not None and previous.shape != self.radiance.shape:
            raise InputError(
                f"{self.name or 'frame'}: history is {tuple(previous.shape)}, the frame {tuple(self.radiance.shape)}; "
                "pass history=None to start anew"
            )

    def layers(self) -> list[tuple[str, Tensor]]:
        """(name, tensor) of every buffer that is there."""
        return [(layer, tensor) for layer in CHANNELS if (tensor := getattr(self, layer)) is not None]

    def map(self, function) -> Frame:
        """The same frame with `function` applied to every tensor."""
        return replace(self, **{layer: function(tensor) for layer, tensor in self.layers()})

    def to(self, *args, **kwargs) -> Frame:
        """Moved to a device or dtype, as `Tensor.to`."""
        return self.map(lambda tensor: tensor.to(*args, **kwargs))

    def crop(self, top: int, left: int, height: int, width: int) -> Frame:
        """A window of the frame; motion stays valid because it is relative."""
        return self.map(lambda tensor: tensor[..., top : top + height, left : left + width])


@dataclass(frozen=True)
class History:
    """The state that one step hands to the next, passed in and returned. Some tensors may be the frame's own: never
    write into them."""

    radiance: Tensor  # [B, 3, H, W] the denoised previous frame
    motion_next: Tensor | None  # [B, 2, H, W] of the previous frame; None: dual motion next time is approximate
    depth: Tensor | None  # [B, 1, H, W] of the previous frame
    normal: Tensor | None  # [B, 3, H, W] of the previous frame
    length: Tensor | None = None  # [B, 1, H, W] frames accumulated in each pixel; None for models that do not count
    mean: Tensor | None = None  # [B, 3, H, W] running mean of irradiance; None for models that keep none
    mean_albedo: Tensor | None = None  # [B, 3, H, W] running mean of albedo, likewise
    noisy: Tensor | None = None  # [B, 3, H, W] radiance of the previous frame, likewise (`shift.light`)
    found: Tensor | None = None  # [B, 2, h, w] shifts that the previous frame found in its picture (`shift.picture`)
    residual: Tensor | None = None  # [B, 3, H, W] running mean of relative residuals (`models.shrinkage.correct`)
    residual_length: Tensor | None = None  # [B, 1, H, W] frames in it
    hidden: tuple[Tensor, ...] = ()  # [B, C, h, w] each: features for the next step of the model, at any scale
    recent: tuple[Tensor, ...] = ()  # [B, 5 or 8, H, W] int32 each: of `ops.keep.keep`, the last frame first
    # [B, 2, h, w] each: those of `found` that count (`shift.picture`), of the previous frame and of `recent` ones
    shifts: tuple[Tensor, ...] = ()
    # [B, 9, H, W] radiance, albedo and normal of this and the recent frames, whatever surface of the pixel they saw
    # (`ops.recall`). No later step needs it: it is for those who filter what has been averaged.
    footprint: Tensor | None = None
    footprint_count: Tensor | None = None  # [B, 1, H, W] frames in it
    # [B, 1, H, W] in [0, 1]: how far the picture trusts the one before; 0 where it has none. Likewise no step needs it:
    # it is for `models.settled`.
    trusted: Tensor | None = None

    def layers(self) -> dict[str, Tensor]:
        """name -> tensor of every field that is there; hidden features are `hidden.0`, `hidden.1` ..., recent frames
        likewise."""
        named = {f.name: tensor for f in fields(self) if (tensor := getattr(self, f.name)) is not None}
        several = {prefix: named.pop(prefix[:-1]) for prefix in SEVERAL}
        return named | {f"{prefix}{i}": t for prefix, tensors in several.items() for i, t in enumerate(tensors)}

    @classmethod
    def from_layers(cls, layers: Mapping[str, Tensor | None]) -> History:
        """The inverse of `layers`; fields that are missing or None are left out. Raises ValueError for unknown names or
        gaps in the hidden features or recent frames."""
        given = {name: tensor for name, tensor in layers.items() if tensor is not None}
        several: dict[str, tuple[Tensor, ...]] = {}
        for prefix in SEVERAL:
            count = sum(name.startswith(prefix) for name in given)
            names = [name for i in range(count) if (name := f"{prefix}{i}") in given]
            several[prefix[:-1]] = tuple(given.pop(name) for name in names)
        if given.keys() - {f.name for f in fields(cls)}:
            raise ValueError(f"not the fields of a history: {', '.join(sorted(layers))}")
        return cls(**dict.fromkeys(("motion_next", "depth", "normal")) | given | several)

    def require(self, carried: Sequence[str]) -> None:
        """Raise InputError unless it is of a network that computes the fields `carried` (`Config.carries`)."""
        there = {name.partition(".")[0] for name in self.layers()}
        kinds = {"mean"} if "mean" in carried else {"mean", "hidden"}  # `parts` hides means of its own beside `mean`
        if differing := sorted(kinds & (there ^ {*carried})):
            found = f"the history {'has' if differing[0] in there else 'lacks'} {differing[0]!r}"
            raise InputError(f"{found}: it is of another kind of model; pass history=None to start anew")


def expect_history(history: object, kind: type = History) -> None:
    """Raise InputError unless `history` is what a `step` takes: of the class `kind` of its states, or None."""
    if not (history is None or isinstance(history, kind)):
        found = f"{type(history).__module__.partition('.')[0]}.{type(history).__name__}"
        raise InputError("step takes the history that the step of the frame before returned beside its image, or None, "
                         f"got {found.removeprefix('builtins.')}")  # fmt: skip


def image_of(history: History | None) -> Tensor | None:
    """The image in a history, None without one. Raises InputError for anything else."""
    expect_history(history)
    return None if history is None else history.radiance


@dataclass(frozen=True)
class Known:
    """Facts about a frame that a step need not find out itself. They are trusted, never checked; `run.plan` and
    `run.tiles` fill them in."""

    first: bool = False  # there is no history
    still: bool = False  # motion, and motion_next of the frame before, are zero everywhere
    covered: bool = False  # no pixel was just uncovered: `motion.occlusion_mask` is empty
    on_surfaces: bool = False  # light moves with its surfaces: nothing is looked for (`shift`)
    sanitised: bool = False  # the frame has been through `sanitise`
    part: bool = False  # the frame is a window of another, whose light is followed as a whole (`shift`)
    exposure: Tensor | None = None  # [B, 1, 1, 1] of the whole picture, where the frame is a window of one
    distance: Tensor | None = None  # [B, 1, 1, 1] likewise: the mean distance of its surfaces (`Denoiser.statistics`)
    noise: Tensor | None = None  # [B, 1, 1, 1] likewise: `exposure.noise_level`
    shift: Tensor | None = None  # [B, 2, H, W] pixels that belong to motion (`shift`)
    # The frames after, the next one first, sanitised and with motion; all but the last have motion_next, as has the
    # frame itself. For networks that keep recent frames (`run.lookahead`).
    ahead: tuple[Frame, ...] = ()
    # How far surfaces turn, or textures move over them, from each of those to the next, [B, 1, H, W] (`models.past`).
    turning: tuple[Tensor, ...] = ()
    # All of them but the last as `History.recent` has frames, where light stays on surfaces (`models.past.coming`).
    coming: tuple[Tensor, ...] = ()
    waits: bool = False  # the frame before had such, too: what is older counts even where its own light was another


NOTHING_KNOWN = Known()


def geometry(frame: Frame) -> History:
    """A sanitised frame as the history that tells whether the next one belongs to its shot (`history.mismatch`)."""
    return History(frame.radiance, frame.motion_next, frame.depth, frame.normal)


def reverse(frame: Frame) -> Frame:
    """The frame as it is when time runs backward: motion and motion_next have changed places."""
    return replace(frame, motion=frame.motion_next, motion_next=frame.motion)


def stack(frames: list[Frame]) -> Frame:
    """Frames of the same size as one batch, with the layers that all of them have."""
    import torch

    names = [layer for layer in CHANNELS if all(getattr(frame, layer) is not None for frame in frames)]
    more = all(frame.more_history for frame in frames)
    layers = {name: torch.cat([getattr(frame, name) for frame in frames]) for name in names}
    return Frame(**layers, number=frames[0].number, more_history=more)
