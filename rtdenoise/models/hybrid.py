"""Kernel prediction, and a network that writes pixels, mixed: the best picture in real time.

A kernel mixes the light that is there; a network that writes pixels also knows pictures, and errs elsewhere. So what
recent frames have seen in each pixel goes through a U-Net that writes pixels, and `ops.mix` makes one picture of these,
the kernels' image and the previous picture. The kernels take it as their own history.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..constants import EVENED_NOISE, MIX_WORD_FROM, MIX_WORD_WHOLE
from ..exposure import noise_level
from ..frame import NOTHING_KNOWN, Frame, History, Known, image_of
from ..ops.around import greatest_around
from ..ops.even_sky import even_sky
from ..ops.evened import evened, held_and_tells
from ..ops.fireflies import without_fireflies
from ..ops.glow import away_from_glow
from ..ops.mix import mix
from ..ops.recall import FOOTPRINT
from ..sanitise import admit
from .accumulated_kpn import AccumulatedKPN, Kernels
from .footprint import seen
from .hybrid_config import HybridConfig
from .pixel_network import PixelNetwork, written


class Hybrid(AccumulatedKPN):
    """The networks and their one-frame step, a `models.Denoiser`."""

    def __init__(self, config: HybridConfig) -> None:
        super().__init__(config)
        self.pixels = PixelNetwork(config)
        self.shares = config.shares  # of `mix`
        self.keeps_footprint = False  # in its history, for others who filter it: `load` with `footprint=True`
        self.keeps_fireflies = config.many  # a lone bright pixel of many samples is true more often than not
        self.needs_history = config.kernels_need_history

    def step_and_kernels(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History, Kernels]:
        """As `AccumulatedKPN.step_and_kernels`; `step` is that, too. Training leaves the kernels, and what filters
        albedo and normal, as they are: no gradient reaches them."""
        frame = admit(frame, image_of(history), known)
        if known.exposure is None:
            exposure, distance = self.statistics(frame)
            known = replace(known, exposure=exposure, distance=distance)
        if known.noise is None:
            known = replace(known, noise=noise_level(frame.radiance, frame.depth))
        with torch.no_grad():
            # Filter by kernels, and average.
            image, after, kernels = super().step_and_kernels(frame, history, replace(known, sanitised=True))
            past, held, trust = kernels.past, kernels.past.held, kernels.trust
            if self.needs_history and frame.more_history:
                trust = trust * (greatest_around(after.footprint_count) - 1).clamp(0, 1)

            # Show the other network what has been seen in each pixel.
            shown = after.footprint if self.config.many else seen(frame, history, after, known, past.later)
            radiance, *guides = shown.split(FOOTPRINT, dim=1)
            if not self.config.many:
                noisy = (known.noise / EVENED_NOISE).clamp(max=1)
                share = away_from_glow(trust * noisy * past.stays, frame.albedo)
                radiance = evened(radiance, after.footprint_count, image, share)
            held, tells = held_and_tells(held, image.dtype)
            word = None if self.config.many else heard(known.noise)
        pixels = written(
            lambda lit: self.pixels(lit, *guides), radiance, image, known.exposure, self.pixels.greatest
        )

        before = None if self.config.many else past.output
        shown = mix(image, pixels, known.exposure, trust, self.shares, before, held, frame.radiance, tells,
                    frame.depth, word)  # fmt: skip
        if not self.keeps_fireflies:
            shown = without_fireflies(shown, frame.depth, frame.normal, trust * held)
        shown = even_sky(shown, frame.radiance, frame.depth)
        after = replace(after, radiance=shown.detach())
        if not self.keeps_footprint:
            after = replace(after, footprint=None, footprint_count=None)
        return shown, after, kernels


def heard(noise: Tensor) -> Tensor:
    """How much the word of a frame of few samples counts (`ops.mix`), in [0, 1], of its `exposure.noise_level`."""
    return ((noise - MIX_WORD_FROM) / (MIX_WORD_WHOLE - MIX_WORD_FROM)).clamp(0, 1)
