"""A torch denoiser that follows the plan: each step leaves out the work that changes nothing, and counts it."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..models import Denoiser
from ..sanitise import sanitise
from .graphs import Step
from .plan import MIN_PLAIN_SHARE, Plan, count, look, rows_unlike, varied_rows
from .tiles import Tiled, carried, step_in_windows, widened

PLAIN_TOLERANCE = 1e-6  # of a frame's brightness: history this close to a colour counts as plain


class Planned:
    """A denoiser whose steps leave out unnecessary work; `left_out` counts the frames. `step` is as the denoiser's.
    `whole`, if given, replaces the denoiser's step for whole frames; windows, whose sizes follow the motion, always
    take the denoiser's own."""

    def __init__(self, denoiser: Denoiser, plan: Plan, whole: Step | None = None) -> None:
        self.denoiser = denoiser
        self.left_out = {"network in plain rows": 0}
        self._tiled = Tiled(denoiser) if plan.tiled else None
        self._whole = self._tiled.step if self._tiled else whole or denoiser.step
        # Only if the history is the last image alone: rows of a running mean may differ where that image is plain.
        self._image_alone = denoiser.config.carries == ("radiance",)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """As the denoiser's own step."""
        frame = frame if known.sanitised else sanitise(frame)
        found = look(frame, history and history.motion_next, history is not None)
        first = found.first and not known.ahead
        known = replace(known, first=first, still=found.still, covered=found.covered, sanitised=True)
        count(self.left_out, known, keeps_means="mean" in self.denoiser.config.carries)
        plain = self._plain(frame, history) if self._image_alone else None
        if plain is None:
            return self._whole(frame, history, known)
        self.left_out["network in plain rows"] += 1
        window, colour = plain
        windows = self._tiled.split(window) if self._tiled else [window] if window[2] > window[0] else []
        return step_in_windows(self.denoiser, frame, history, known, windows, colour)

    def _plain(self, frame: Frame, history: History | None) -> tuple[tuple[int, int, int, int], Tensor] | None:
        """The window outside which all light has one colour, and that colour; None where the saving is too small."""
        H, W = frame.size
        top, bottom, colour = varied_rows(frame.radiance)
        if bottom - top > (1 - MIN_PLAIN_SHARE) * H:
            return None
        spans, lengths = [(top, bottom)] if bottom > top else [], carried(frame, history)
        if history is not None:
            # No weight of a softmax is zero: without a tolerance light would seep a kernel farther in every frame.
            faint = PLAIN_TOLERANCE / exposure(frame.radiance).item()
            if before := rows_unlike(history.radiance, colour, faint):
                reach = int(lengths[:, 1].max())
                spans.append((before[0] - reach, before[1] + reach))
        if not spans:
            return (0, 0, 0, W), colour
        network, light = self.denoiser.config.network_reach, self.denoiser.config.light_reach
        core = max(0, min(s[0] for s in spans) - light), 0, min(H, max(s[1] for s in spans) + light), W
        window = widened(core, lengths, network, (H, W))
        return (core, colour) if window[2] - window[0] <= (1 - MIN_PLAIN_SHARE) * H else None
