"""What a sequence needs, and what is left out because it changes nothing: decided from the headers and the first
frames, checked again in every frame, counted.

| left out                    | where                                                                | output  |
|-----------------------------|----------------------------------------------------------------------|---------|
| layers that nobody asks for | one frame; a model without dual motion                               | same    |
| the warp of history         | motion, and motion_next before it, are zero everywhere               | same    |
| dual motion                 | motion + motion_next before it: short, whichever pixels are compared | same    |
| the network in the dark     | rows farther than `tiles.light_reach` from light of frame or history | rounded |
| the whole frame at once     | `TILED_FROM` pixels or more: in tiles                                | rounded |

Same: to the bit. Rounded: convolutions over another size sum in another order, 1e-5 relative in float32.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise

import torch
from torch import Tensor, nn

from .frame import NOTHING_KNOWN, Frame, History, Known, sanitise
from .motion import OCCLUSION_THRESHOLD, on_screen
from .tiles import Tiled, keeps_only_the_image, light_reach, network_reach, step_in_windows

LAYERS = ("radiance", "albedo", "normal", "depth", "motion", "motion_next")
TILED_FROM = 3840 * 2160  # pixels; some 2 GB of features in float32
WORTH = 0.15  # share of the rows that must be dark for the rest to be denoised as a window of its own


@dataclass(frozen=True)
class Decision:
    """One thing that can be left out."""

    what: str
    left_out: str  # where: "always", "never", or how many of the examined frames
    why: str  # the condition


@dataclass(frozen=True)
class Plan:
    """What a sequence needs."""

    layers: tuple[str, ...]  # of `Frame`, to be read; others are not looked at
    tiled: bool
    decisions: tuple[Decision, ...] = field(repr=False)

    def to_json(self) -> dict:
        """For the summary of a run."""
        return asdict(self)


def make_plan(size: tuple[int, int], count: int, model_motion: str, first: list[Frame]) -> Plan:
    """The plan for `count` frames of `size` (H, W), of which the `first` have been looked at, and a model that fetches
    history with `model_motion` ('dual' or 'traditional')."""
    unread = {}
    if count == 1:
        unread = dict.fromkeys(("motion", "motion_next"), "a single frame has no history")
    elif model_motion == "traditional":
        unread = {"motion_next": "the model fetches history with traditional motion"}
    decisions = [Decision(f"layer {layer}", "always", why) for layer, why in unread.items()]
    if pairs := [(a.motion_next, b) for a, b in pairwise(first) if b.number == a.number + 1]:
        still, covered = (sum(holds(frame, before) for before, frame in pairs) for holds in (_still, _covered))
        decisions += [
            Decision("warp of history", f"{still} of {len(pairs)} frames examined", "where nothing moves"),
            Decision("dual motion", f"{covered} of {len(pairs)} frames examined", "where no pixel can be uncovered"),
        ]
    lit = [_lit_rows(frame.radiance) or (0, 0) for frame in first]
    dark = sum(bottom - top <= (1 - WORTH) * size[0] for top, bottom in lit)
    decisions.append(Decision("network in black rows", f"{dark} of {len(first)} frames examined at most",
                              "where no light reaches them"))  # fmt: skip
    tiled = size[0] * size[1] >= TILED_FROM
    decisions.append(Decision("the whole frame at once", "always, in tiles" if tiled else "never",
                              f"from {TILED_FROM:,} pixels on, here {size[0] * size[1]:,}"))  # fmt: skip
    return Plan(tuple(layer for layer in LAYERS if layer not in unread), tiled, tuple(decisions))


class Planned:
    """A denoiser that leaves out of each step what the step does not need. `step` as the denoiser's; `left_out` counts
    the frames."""

    def __init__(self, denoiser: nn.Module, plan: Plan) -> None:
        self.denoiser = denoiser
        self.left_out = {"warp of history": 0, "dual motion": 0, "network in black rows": 0}
        self._tiled = Tiled(denoiser) if plan.tiled else None
        self._reach: tuple[int, int] | None = None  # of the network and of light; found when they are needed
        self._rows_are_dark = keeps_only_the_image(denoiser)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """As the denoiser's own step."""
        frame = frame if known.sanitised else sanitise(frame)
        still = history is not None and _still(frame, history.motion_next)
        covered = still or (history is not None and _covered(frame, history.motion_next))
        self.left_out["warp of history"] += still
        self.left_out["dual motion"] += covered
        known = replace(known, still=still, covered=covered, sanitised=True)
        if self._tiled:
            return self._tiled.step(frame, history, known)
        rows = self._rows(frame, history)
        if rows is None:
            return self.denoiser.step(frame, history, known)
        self.left_out["network in black rows"] += 1
        cores = [(rows[0], 0, rows[1], frame.size[1])] if rows[1] > rows[0] else []
        return step_in_windows(self.denoiser, frame, history, known, cores, self._reaches()[0])

    def _reaches(self) -> tuple[int, int]:
        if self._reach is None:
            self._reach = network_reach(self.denoiser), light_reach(self.denoiser)
        return self._reach

    def _rows(self, frame: Frame, history: History | None) -> tuple[int, int] | None:
        """First and last (excluded) row that light can reach; None where leaving out the rest is not worth while, or a
        history holds more than an image, of which black rows do not say what becomes of it."""
        H, lit = frame.size[0], _lit_rows(frame.radiance)
        if lit == (0, H) or not self._rows_are_dark:
            return None
        spans = [lit] if lit else []
        if history is not None and (before := _lit_rows(history.radiance)):
            reach = _longest(frame, history)
            spans.append((before[0] - reach, before[1] + reach))
        if not spans:
            return 0, 0
        network, light = self._reaches()
        top, bottom = min(s[0] for s in spans) - light, max(s[1] for s in spans) + light
        kept = min(H, bottom + network) - max(0, top - network)
        return (max(0, top), min(H, bottom)) if kept <= (1 - WORTH) * H else None


def _still(frame: Frame, motion_next_before: Tensor | None) -> bool:
    if frame.motion is None or (motion_next_before is not None and bool(motion_next_before.any())):
        return False
    return not bool(frame.motion.any())


def _covered(frame: Frame, motion_next_before: Tensor | None) -> bool:
    """Whether ‖dual − motion‖ can exceed the threshold nowhere: dual is a value of −motion_next, whichever."""
    if frame.motion is None or motion_next_before is None:
        return False
    low, high = torch.aminmax(frame.motion.transpose(0, 1).flatten(1), dim=1)
    next_low, next_high = torch.aminmax(motion_next_before.transpose(0, 1).flatten(1), dim=1)
    farthest = torch.maximum(high + next_high, -(low + next_low))
    return bool(farthest.norm() < 0.999 * OCCLUSION_THRESHOLD)  # a margin for rounding


def _lit_rows(image: Tensor) -> tuple[int, int] | None:
    """First and last (excluded) row with light in it; None in a black image."""
    rows = (image != 0).any(dim=1).any(dim=2)[0].nonzero()
    return (int(rows[0]), int(rows[-1]) + 1) if len(rows) else None


def _longest(frame: Frame, history: History) -> int:
    """Rows that history can be carried over: by motion, or by dual motion, where either leads to the screen."""
    H = frame.size[0]
    vertical = torch.where(on_screen(frame.motion), frame.motion, 0.0)[:, 1].abs().max()
    if history.motion_next is None:
        return int(2 * vertical) + 5  # the splat; see tiles
    dual = history.motion_next[:, 1].abs()
    return int(torch.maximum(vertical, torch.where(dual < H, dual, 0.0).max())) + 2
