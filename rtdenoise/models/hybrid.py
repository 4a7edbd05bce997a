"""Kernel prediction, and a network that writes pixels, mixed: the best picture in real time.

A kernel mixes the light that is there; a network that writes pixels also knows pictures, and errs elsewhere. So what
recent frames have seen in each pixel goes through a U-Net that writes pixels, and `mixing` makes one picture of these,
the kernels' image and the previous picture. The kernels take it as their own history.

The network that writes pixels is that of Open Image Denoise (Áfra 2019-2025, Apache License 2.0), with its weights.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..constants import MIX_SHARES, MIX_SHARES_OF_MANY, PIXELS_CONTRAST, PIXELS_UNIT
from ..exposure import noise_level
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..ops.around import expand_within
from ..ops.even_sky import even_sky
from ..ops.evened import evened
from ..ops.features import features
from ..ops.max_pool import max_pool
from ..ops.recall import FOOTPRINT
from ..ops.to_planes import to_planes
from ..sanitise import admit
from .accumulated_kpn import AccumulatedKPN
from .hybrid_config import HybridConfig
from .mixing import mix
from .past import followed, seen
from .unet import ConvRelu, Up


class Hybrid(AccumulatedKPN):
    """The networks and their one-frame step, a `models.Denoiser`."""

    def __init__(self, config: HybridConfig) -> None:
        super().__init__(config)
        self.pixels = PixelNetwork(config)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """As `Denoiser.step`. Training leaves the kernels as they are: no gradient reaches them."""
        frame = admit(frame, history and history.radiance, known)
        if known.exposure is None:
            exposure, distance = self.statistics(frame)
            known = replace(known, exposure=exposure, distance=distance)
        if known.noise is None:
            known = replace(known, noise=noise_level(frame.radiance, frame.depth))
        with torch.no_grad():
            # Filter by kernels, and average.
            image, after, kernels = self.step_and_kernels(frame, history, replace(known, sanitised=True))
            past = kernels.past
            held = past.on_screen & ~past.uncovered
            trust = 1 - held * kernels.heads.reset

            # Show the other network what has been seen in each pixel.
            shown = after.footprint if self.config.many else seen(frame, history, after, known, past.later)
            radiance, *guides = shown.split(FOOTPRINT, dim=1)
            if not self.config.many:
                radiance = evened(radiance, after.footprint_count, image, trust)
            scale = PIXELS_CONTRAST * known.exposure
        pixels = expand_within(self.pixels(radiance, *guides, scale), scale, radiance, image)

        before, shares = (None, MIX_SHARES_OF_MANY) if self.config.many else (past.output, MIX_SHARES)
        shown = mix(image, pixels, known.exposure, trust, before, held, shares=shares, noisy=frame.radiance)
        shown = even_sky(shown, frame.radiance, frame.depth)
        after = replace(after, radiance=shown.detach())
        return shown, after if known.part else followed(frame, history, after, self.config.recent + 1)


class PixelNetwork(nn.Module):
    """A U-Net from a picture's light and surfaces to its pixels."""

    def __init__(self, config: HybridConfig) -> None:
        super().__init__()
        self.encoder = nn.ModuleList(ConvRelu(a, b, 3, padding=1) for a, b in config.convolutions)
        self.decoder = nn.ModuleList(Up(*level) for level in config.levels)
        self.last = nn.Conv2d(config.out[0], 3, 3, padding=1)

    def forward(self, radiance: Tensor, albedo: Tensor, normal: Tensor, scale: Tensor) -> Tensor:
        """What each pixel showed, `[B, 3, H, W]` each, and its exposure `scale`, `[B, 1, 1, 1]`, to the picture's light
        as `features` compress it, `[B, 3, H, W]` ≥ 0 in float32."""
        H, W = radiance.shape[2:]
        x = self.input(radiance, albedo, normal, scale)
        cell = 2 ** len(self.decoder)
        if H % cell or W % cell:  # by nothing, as OIDN does: the last row, repeated, would look like stripes of light
            x = F.pad(x, (0, -W % cell, 0, -H % cell))
        skips = [x]
        x = self.encoder[1](self.encoder[0](x))
        for convolve in self.encoder[2:-1]:
            x = max_pool(x)
            skips.append(x)
            x = convolve(x)
        x = self.encoder[-1](x)
        for level in reversed(range(len(self.decoder))):
            x = self.decoder[level](x, skips[level])
        y = to_planes(x, self.last.weight, self.last.bias)
        return F.relu(y[..., :H, :W]) / PIXELS_UNIT

    @torch.no_grad()
    def input(self, radiance: Tensor, albedo: Tensor, normal: Tensor, scale: Tensor) -> Tensor:
        """`features`, `[B, 9, H, W]`, with light in OIDN's unit."""
        lanes = self.encoder[0].lanes
        return features((radiance,), (albedo, normal), scale, self.last.weight, PIXELS_UNIT, lanes)
