"""The plan of a sequence: work that would change nothing is left out. It is decided from the headers and the first
frames, checked again in every frame, and counted.

| left out                    | where                                                                | output  |
|-----------------------------|----------------------------------------------------------------------|---------|
| layers that no step reads   | motion of one frame; a model without dual motion                     | same    |
| the warp of history         | motion, and motion_next before it, are zero everywhere               | same    |
| dual motion                 | motion + motion_next before it: short, whichever pixels are compared | same    |
| running means               | no history: a first frame, a frame after a cut, a single picture     | rounded |
| the network in plain rows   | rows farther than `config.light_reach` from light that varies        | rounded |
| the whole frame at once     | `TILED_FROM` pixels or more: in tiles                                | rounded |

Same: to the bit. Rounded: convolutions over another size or fewer channels sum in another order, 1e-5 relative in
float32. The last two are torch's (`planned.Planned`), the others serve every backend. This module needs no torch:
layers are tensors or numpy arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..frame import OCCLUSION_THRESHOLD, Frame, Known
from .summary import add

if TYPE_CHECKING:
    from torch import Tensor

LAYERS = ("radiance", "albedo", "normal", "depth", "motion", "motion_next")
TILED_FROM = 3840 * 2160  # pixels; some 2 GB of features in float32
MIN_PLAIN_SHARE = 0.25  # of the rows: with fewer plain rows a window of the others saves too little


@dataclass(frozen=True)
class Decision:
    """A piece of work that can be left out."""

    what: str
    left_out: str  # "always", "never", or the number of the examined frames
    why: str  # the condition


@dataclass(frozen=True)
class Plan:
    """The work that a sequence needs."""

    layers: tuple[str, ...]  # of `Frame`, to be read; no others are
    tiled: bool
    decisions: tuple[Decision, ...] = field(repr=False)

    def to_json(self) -> dict:
        """For the summary of a run."""
        return asdict(self)


def make_plan(
    size: tuple[int, int],  # (H, W)
    frames: int,  # how many
    model_motion: str | None,  # motion that fetches history: 'dual' or 'traditional'; None: the model reads no motion
    first: Sequence[Frame],  # the frames to examine
    windows: bool = True,  # whether backend and model can denoise a frame in windows
    reads: tuple[str, ...] = (),  # layers that the model reads beside `LAYERS`
) -> Plan:
    """The plan for a sequence."""
    unread = {}
    if model_motion is None:
        unread = dict.fromkeys(("motion", "motion_next"), "the model denoises each frame alone")
    elif frames == 1:
        unread = {"motion": "a single frame has no history"}  # its motion_next is that of a frame which may be appended
    if model_motion == "traditional":
        unread |= {"motion_next": "the model fetches history with traditional motion"}
    decisions = [Decision(f"layer {layer}", "always", why) for layer, why in unread.items()]
    where = "always" if frames == 1 else "in first frames"
    decisions.append(Decision("running means", where, "where there is no history"))
    if known := [look(b, a.motion_next) for a, b in pairwise(first) if b.number == a.number + 1]:
        still, covered = sum(k.still for k in known), sum(k.covered for k in known)
        decisions += [
            Decision("warp of history", f"{still} of {len(known)} frames examined", "where nothing moves"),
            Decision("dual motion", f"{covered} of {len(known)} frames examined", "where no pixel can be uncovered"),
        ]
    tiled = windows and size[0] * size[1] >= TILED_FROM
    if windows:
        varied = (varied_rows(frame.radiance) for frame in first)
        plain = sum(bottom - top <= (1 - MIN_PLAIN_SHARE) * size[0] for top, bottom, _ in varied)
        decisions += [
            Decision("network in plain rows", f"{plain} of {len(first)} frames examined at most",
                     "where light is the same far and wide"),
            Decision("the whole frame at once", "always, in tiles" if tiled else "never",
                     f"from {TILED_FROM:,} pixels on, here {size[0] * size[1]:,}"),
        ]  # fmt: skip
    return Plan((*(layer for layer in LAYERS if layer not in unread), *reads), tiled, tuple(decisions))


def look(frame: Frame, motion_next_before: Tensor | None, history: bool = True) -> Known:
    """Find the facts that let a step of `frame` leave work out. `motion_next_before` is that of the previous frame,
    None where it has none or there is no `history`."""
    if not history:
        return Known(first=True)
    if frame.motion is None:
        return Known()
    low, high = _extent(frame.motion)
    if motion_next_before is None:  # it is splatted from motion (`splat`), so dual motion is some value of motion
        next_low, next_high = [-v for v in high], [-v for v in low]
    else:
        next_low, next_high = _extent(motion_next_before)
    still = not any([*low, *high, *next_low, *next_high])
    # Dual motion is some value of -motion_next_before: this bounds its distance from motion. NaN is not less.
    apart = math.hypot(*(max(high[i] + next_high[i], -(low[i] + next_low[i])) for i in (0, 1)))
    return Known(still=still, covered=apart < 0.999 * OCCLUSION_THRESHOLD)  # a margin for rounding


def count(left_out: dict[str, int], known: Known, keeps_means: bool) -> None:
    """Count a frame for each piece of work that it leaves out."""
    means = known.first and keeps_means
    add(left_out, {"running means": means, "warp of history": known.still, "dual motion": known.covered})


def varied_rows(image: Tensor) -> tuple[int, int, Tensor]:
    """First and last (excluded) row of `image` `[1, 3, H, W]` that differs from a colour `[1, 3, 1, 1]`, and the
    colour: a night above a street, an even sky. (0, 0) if no row differs. The colour is that of the first or the last
    pixel, whichever leaves fewer rows."""
    corners = image[..., :1, :1], image[..., -1:, -1:]
    spans = [(*(rows_unlike(image, colour) or (0, 0)), colour) for colour in corners]
    return min(spans, key=lambda span: span[1] - span[0])


def rows_unlike(image: Tensor, colour: Tensor, tolerance: float = 0.0) -> tuple[int, int] | None:
    """First and last (excluded) row that differs from `colour` by more than `tolerance`; None if no row does."""
    with np.errstate(invalid="ignore"):  # frames that are examined first are not sanitised
        differs = ~(abs(image - colour) <= tolerance)  # True for NaN too
    unlike = [row for row, found in enumerate(differs.any(1).any(2).any(0).tolist()) if found]
    return (unlike[0], unlike[-1] + 1) if unlike else None


def _extent(motion: Tensor) -> tuple[list[float], list[float]]:
    """Minimum and maximum of x and y in a motion field."""
    axes = (0, 2, 3)
    if isinstance(motion, np.ndarray):
        return motion.min(axes).tolist(), motion.max(axes).tolist()
    return motion.amin(axes).tolist(), motion.amax(axes).tolist()
