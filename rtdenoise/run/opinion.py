"""`denoise --oidn`: a second opinion in real time, mixed into the network's picture.

OIDN sees one frame, and no network here filters a single frame as well. So it gets what the last frames have seen in
each pixel, radiance, albedo and normal (`History.footprint`). With f(x) = log(1 + x), exposure s, the previous picture
where this pixel was (`before`) and the trust t in the network's history, 1 - its reset,

    mixed = t a · f(s · network) + (1 - t a) · f(s · OIDN)
    image = f⁻¹(t b · f(s · before) + (1 - t b) · mixed) / s

with a and b from SHARE and KEPT. The image is the history of the next frame: the network averages it as its own.

A pixel that one frame has seen, among others that many have, is noisier than these, and OIDN takes that for texture. So
a little of the network's image stands in for its light (`models.past.evened`).
"""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from ..baselines.oidn import Oidn, installed
from ..color import compress, expand
from ..errors import InputError
from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..models.past import evened
from ..models.presets import Config
from ..ops import warp
from ..ops.even_sky import even_sky
from ..ops.recall import FOOTPRINT, reset_of
from ..sanitise import sanitise
from ..splat import history_motion
from .graphs import Step

RECENT = 8  # frames that the network keeps here, whatever its configuration says
# Shares of the network against OIDN, and of the previous picture against both: of networks that keep recent frames by
# themselves, and of the others, `many` above all, for many samples a pixel, where a lookup costs more than noise does.
SHARE, KEPT = {True: 0.4, False: 0.3}, {True: 0.1, False: 0.0}


class Opinion:
    """OIDN, asked about the frames of one network."""

    def __init__(self, config: Config) -> None:
        """`config` of the network as it is stored. Raises InputError where `pyoidn` is not installed."""
        if not installed():
            raise InputError("--oidn: OIDN is not installed: pip install pyoidn")
        self._few, self._motion = config.recent > 0, config.motion
        self._share, self._kept = SHARE[self._few], KEPT[self._few]
        self._oidn = Oidn()

    def step(
        self, step: Step, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """The step of a network whose history has `footprint`, with OIDN's opinion mixed into its image. Raises
        InputError for batches."""
        if len(frame.radiance) != 1:
            raise InputError(f"OIDN takes one picture at a time, got {len(frame.radiance)}")
        frame, known = frame if known.sanitised else sanitise(frame), replace(known, sanitised=True)
        image, onward = step(frame, history, known)
        radiance, albedo, normal = onward.footprint.split(FOOTPRINT, dim=1)
        if history is not None and self._few:
            radiance = evened(radiance, onward.footprint_count, image)
        picture, _ = self._oidn.step(replace(frame, radiance=radiance, albedo=albedo, normal=normal))
        if history is None:
            image = mixed(image, picture, self._share)
        else:
            trust = 1 - reset_of(onward.recent[0])
            image = mixed(image, picture, self._share * trust)
            if self._kept:
                motion, seen, uncovered = history_motion(frame, history, self._motion)
                before = warp(history.radiance, motion, seen, image, cubic=True)
                image = mixed(before, image, self._kept * trust * ~uncovered)
        image = even_sky(image, frame.radiance, frame.depth)  # OIDN filters the sky, too
        return image, replace(onward, radiance=image)


def mixed(image: Tensor, picture: Tensor, share: Tensor | float) -> Tensor:
    """`share` of an image and the rest of a picture, `[1, 3, H, W]`, in the domain of f."""
    scale = exposure(image)
    ours, theirs = (compress(scale * x.clamp(min=0)) for x in (image, picture))
    return expand(share * ours + (1 - share) * theirs) / scale
