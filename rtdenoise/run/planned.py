"""A torch denoiser that follows the plan: what changes nothing is left out of every step, and counted."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor, nn

from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..sanitise import sanitise
from .graphs import Step
from .plan import WORTH, Plan, count, look, rows_unlike, varied_rows
from .tiles import Tiled, carried, keeps_only_the_image, light_reach, network_reach, step_in_windows, widened

FAINT = 1e-6  # of a frame's brightness: history may differ by so much from a colour that it is taken for


class Planned:
    """A denoiser that leaves out of each step what the step does not need. `step` as the denoiser's; `left_out` counts
    the frames. `whole` is the step that whole frames take, the denoiser's own unless another is given; windows, whose
    sizes follow the motion, take its own always."""

    def __init__(self, denoiser: nn.Module, plan: Plan, whole: Step | None = None) -> None:
        self.denoiser = denoiser
        self.left_out = {"network in plain rows": 0}
        self._tiled = Tiled(denoiser) if plan.tiled else None
        self._whole = self._tiled.step if self._tiled else whole or denoiser.step
        self._reach: tuple[int, int] | None = None  # of the network and of light; found when they are needed
        self._image_alone = keeps_only_the_image(denoiser)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """As the denoiser's own step."""
        frame = frame if known.sanitised else sanitise(frame)
        found = look(frame, history and history.motion_next, history is not None)
        known = replace(known, first=found.first, still=found.still, covered=found.covered, sanitised=True)
        count(self.left_out, known, keeps_means=not self._image_alone)
        plain = self._plain(frame, history) if self._image_alone else None
        if plain is None:
            return self._whole(frame, history, known)
        self.left_out["network in plain rows"] += 1
        window, colour = plain
        windows = self._tiled.split(window) if self._tiled else [window] if window[2] > window[0] else []
        return step_in_windows(self.denoiser, frame, history, known, windows, self._reaches()[0], colour)

    def _reaches(self) -> tuple[int, int]:
        if self._reach is None:
            self._reach = network_reach(self.denoiser), light_reach(self.denoiser)
        return self._reach

    def _plain(self, frame: Frame, history: History | None) -> tuple[tuple[int, int, int, int], Tensor] | None:
        """The window out of which all light is of one colour, and that colour; None where leaving out the rest is not
        worth while. For models whose history is the last image: of others one colour does not say what becomes of it.
        """
        H, W = frame.size
        top, bottom, colour = varied_rows(frame.radiance)
        if bottom - top > (1 - WORTH) * H:
            return None
        spans, lengths = [(top, bottom)] if bottom > top else [], carried(frame, history)
        if history is not None:
            # No weight of a kernel is zero: without a tolerance light would seep on, a kernel further in every frame.
            faint = FAINT / exposure(frame.radiance).item()
            if before := rows_unlike(history.radiance, colour, faint):
                reach = int(lengths[:, 1].max())
                spans.append((before[0] - reach, before[1] + reach))
        if not spans:
            return (0, 0, 0, W), colour
        network, light = self._reaches()
        core = max(0, min(s[0] for s in spans) - light), 0, min(H, max(s[1] for s in spans) + light), W
        window = widened(core, lengths, network, (H, W))
        return (core, colour) if window[2] - window[0] <= (1 - WORTH) * H else None
