"""`denoise --oidn`: a second opinion in real time, mixed into the network's picture.

OIDN sees one frame, and no network here filters a single frame as well. So it gets what the last frames have seen in
each pixel, radiance, albedo and normal (`History.footprint`). With f(x) = log(1 + x), exposure s and the
network's share a

    image = f⁻¹(a · f(s · network) + (1 - a) · f(s · OIDN)) / s

A pixel that one frame has seen, among others that many have, is noisier than these, and OIDN takes that for texture. So
a little of the network's image stands in for its light (`evened`). History stays the network's own.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..baselines.oidn import Oidn, installed
from ..color import compress, expand
from ..errors import InputError
from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..models.presets import Config
from ..ops.even_sky import even_sky
from ..ops.recall import FOOTPRINT
from ..sanitise import sanitise
from .graphs import Step

RECENT = 8  # frames that the network keeps here, whatever its configuration says
# The network's share: of those that keep recent frames by themselves, and of the others, `many` above all, which loses
# more of what many samples show (docs/notes/opinion.md).
SHARES = {True: 0.5, False: 0.3}
SEEN_ONCE = 0.8  # the noisy light's share of OIDN's input where one frame has seen a pixel, and others have a history


class Opinion:
    """OIDN, asked about the frames of one network."""

    def __init__(self, config: Config) -> None:
        """`config` of the network as it is stored. Raises InputError where `pyoidn` is not installed."""
        if not installed():
            raise InputError("--oidn: OIDN is not installed: pip install pyoidn")
        self._evens = config.recent > 0
        self._oidn, self._share = Oidn(), SHARES[self._evens]

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
        if history is not None and self._evens:
            radiance = evened(radiance, onward.footprint_count, image)
        picture, _ = self._oidn.step(replace(frame, radiance=radiance, albedo=albedo, normal=normal))
        image = mixed(image, picture, self._share)
        return even_sky(image, frame.radiance, frame.depth), onward  # OIDN filters the sky, too


def evened(light: Tensor, count: Tensor, image: Tensor) -> Tensor:
    """Averaged light `[1, 3, H, W]` with some of `image` where `count` `[1, 1, H, W]` frames, one to two, are in it."""
    return torch.lerp(image, light, SEEN_ONCE + (1 - SEEN_ONCE) * (count - 1).clamp(0, 1))


def mixed(image: Tensor, picture: Tensor, share: float) -> Tensor:
    """`share` of the network's image and the rest of OIDN's picture, `[1, 3, H, W]`; the equation stands above."""
    scale = exposure(image)
    ours, theirs = (compress(scale * x) for x in (image, picture.clamp(min=0)))
    return expand(share * ours + (1 - share) * theirs) / scale
