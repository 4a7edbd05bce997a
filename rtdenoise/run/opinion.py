"""`denoise --oidn`: a second opinion in real time, mixed into the network's picture.

OIDN sees one frame, and no network here filters a single frame as well. So it gets what the last frames have seen in
each pixel, radiance, albedo and normal (`History.footprint`), and `models.mixing` makes one picture of both and the
previous one. It is the history of the next frame.

A pixel that one frame has seen, among others that many have, is noisier than these, and OIDN takes that for texture. So
a little of the network's image stands in for its light (`ops.evened`).
"""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from ..baselines.oidn import Oidn, installed
from ..constants import MIX_SHARES, MIX_SHARES_OF_MANY
from ..errors import InputError
from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..models.mixing import mix
from ..models.past import followed, later, seen, shifted
from ..models.presets import Config
from ..ops import warp
from ..ops.even_sky import even_sky
from ..ops.evened import evened
from ..ops.recall import FOOTPRINT, reset_of
from ..sanitise import sanitise
from ..splat import history_motion
from .graphs import Step

RECENT = 8  # frames that the network keeps here, whatever its configuration says


class Opinion:
    """OIDN, asked about the frames of one network."""

    def __init__(self, config: Config) -> None:
        """`config` of the network as it is stored. Raises InputError where `pyoidn` is not installed."""
        if not installed():
            raise InputError("oidn: OIDN is not installed: pip install pyoidn")
        self._oidn, self._motion = Oidn(), config.motion
        self._few = config.recent > 0 and not getattr(config, "many", False)
        self._config = replace(config, footprint=True) if self._few else config
        self.shares = MIX_SHARES if self._few else MIX_SHARES_OF_MANY  # no recent frames of its own: it is `many`

    def step(
        self, step: Step, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """The step of a network whose history has `footprint`, with OIDN's opinion mixed into its image. Raises
        InputError for batches."""
        if len(frame.radiance) != 1:
            raise InputError(f"OIDN takes one picture at a time, got {len(frame.radiance)}")
        frame, known = frame if known.sanitised else sanitise(frame), replace(known, sanitised=True)
        known = shifted(frame, history, known)
        image, onward = step(frame, history, replace(known, part=True))
        shown = onward.footprint
        if self._few:
            shown = seen(frame, history, onward, known, later(self._config, frame, known))
        radiance, albedo, normal = shown.split(FOOTPRINT, dim=1)
        trust, before, held = 1.0, None, 1.0
        if history is not None:
            motion, inside, uncovered = history_motion(frame, history, self._motion, known.shift)
            held = inside & ~uncovered
            trust = 1 - held * reset_of(onward.recent[0])
            if self.shares[1]:
                before = warp(history.radiance, motion, inside, image, cubic=True)
        if self._few:
            radiance = evened(radiance, onward.footprint_count, image, trust)
        picture, _ = self._oidn.step(replace(frame, radiance=radiance, albedo=albedo, normal=normal))
        image = mix(image, picture, exposure(image), trust, before, held, self.shares, frame.radiance)
        image = even_sky(image, frame.radiance, frame.depth)  # OIDN filters the sky, too
        return image, followed(frame, history, replace(onward, radiance=image), RECENT + 1)
