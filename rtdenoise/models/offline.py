"""Combine what several denoisers made of a frame on disk, pixel by pixel: `denoise --offline`.

A frame on disk has a future. The real-time network runs over it forward in time, backward, and alone; Intel's OIDN
filters the frame, and the light that both passes have averaged over time. These candidates err in different places, so
a weighted sum of them beats each:

    image = F + Σ_i w_i (c_i - F),    Σ_i w_i = 1,    in log(1 + exposure · light)

with F the forward candidate and weights w that a small U-Net predicts for every pixel. Weights may be negative: forward
and backward pass share the noise of the current frame, and the single frame tells which part of them that is. Where all
candidates are equal the image equals them to the bit. `Mix.combine` first.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..color import compress, expand
from ..exposure import exposure
from ..frame import Frame, mean_distance
from ..ops.pixels import nearness
from .config import CANDIDATES, MixConfig
from .inference import as_weights
from .unet import ConvRelu, UNet

BEYOND = 0.5  # of the candidates' range: the image leaves that range by no more, whatever the weights


@dataclass(frozen=True)
class Candidates:
    """What is known of one frame; light is `[B, 3, H, W]` linear radiance. Without OIDN the last two lights are None."""

    forward: Tensor  # the network with the frames before as history
    backward: Tensor  # the network with the frames after
    single: Tensor  # the network without history
    second: Tensor | None  # OIDN's frame
    averaged: Tensor | None  # OIDN of the light that both passes have averaged
    lengths: Tensor  # [B, 2, H, W] frames averaged in each pixel by the forward and the backward pass
    uncovered: Tensor  # [B, 2, H, W] 1 where a moving object has just uncovered the pixel, forward and backward in time

    def images(self) -> list[Tensor | None]:
        """The light, in the order of `config.CANDIDATES`."""
        return [getattr(self, name) for name in CANDIDATES]


@dataclass(frozen=True)
class Mixed:
    """A combined frame."""

    image: Tensor  # [B, 3, H, W] linear radiance
    spread: Tensor  # [B, 1, H, W] radiance: Σ |w_i| |c_i - image|, how far the candidates are from the image


class Mix(nn.Module):
    """The network that weighs candidates, and `combine`, which applies it."""

    def __init__(self, config: MixConfig) -> None:
        super().__init__()
        self.config = config
        self.stem = ConvRelu(config.features, config.widths[0], 4, stride=2, padding=1)
        self.unet = UNet(config.widths[0], config.widths)
        self.full_head = nn.ConvTranspose2d(config.widths[0], len(CANDIDATES), 2, stride=2)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)
        nn.init.zeros_(self.full_head.weight)
        with torch.no_grad():
            self.full_head.bias.copy_(torch.tensor(config.start))

    def combine(self, frame: Frame, candidates: Candidates) -> Mixed:
        """The weighted sum of the candidates of a sanitised frame; never negative."""
        scale = exposure(candidates.forward)
        images = candidates.images()
        there = torch.tensor([image is not None for image in images], device=scale.device)
        light = torch.stack([compress(scale * (candidates.forward if c is None else c)) for c in images], dim=1)
        base = light[:, :1]

        logits = self.predict(self.features(frame, candidates, light, there, scale)).float()
        weights = self.normalised(logits, there)[:, :, None]  # [B, candidates, 1, H, W]

        change = (weights * (light - base)).sum(1)
        kept = light[:, there]
        low, high = kept.amin(1), kept.amax(1)
        margin = BEYOND * (high - low)
        mixed = (base[:, 0] + change).maximum(low - margin).minimum(high + margin).clamp(min=0)
        image = torch.where(change == 0, candidates.forward, expand(mixed) / scale)
        apart = sum(
            w.abs() * (c - image).abs() for w, c in zip(weights.unbind(1), images, strict=True) if c is not None
        )
        return Mixed(image, apart.mean(1, keepdim=True))

    def features(
        self, frame: Frame, candidates: Candidates, light: Tensor, there: Tensor, scale: Tensor
    ) -> Tensor:  # light: [B, candidates, 3, H, W], compressed
        """The network's input `[B, config.features, H, W]` in the dtype of its weights. Candidates that are not there
        look like the forward one; a channel says so."""
        B, _, _, H, W = light.shape
        return as_weights(torch.cat([
            light.flatten(1, 2), compress(scale * frame.radiance), frame.albedo, frame.normal,
            nearness(frame.depth, mean_distance(frame.depth)), candidates.lengths / self.config.longest,
            candidates.uncovered, there[-1].to(light.dtype).expand(B, 1, H, W),
        ], dim=1), self)  # fmt: skip

    def predict(self, features: Tensor) -> Tensor:
        """Run the network at half size: one number a candidate and pixel, `[B, candidates, H, W]`."""
        H, W = features.shape[2:]
        pad = 0, max(W % 2, 4 - W), 0, max(H % 2, 4 - H)
        features = F.pad(features, pad, mode="replicate") if any(pad) else features
        level = self.unet(self.stem(features)[:, :, : (H + 1) // 2, : (W + 1) // 2], 1)[0]
        return self.full_head(level)[:, :, :H, :W]

    @staticmethod
    def normalised(logits: Tensor, there: Tensor) -> Tensor:
        """Weights that sum to 1 over the candidates that are there, 0 for the others; the same number is added to
        all."""
        there = there.reshape(1, -1, 1, 1).to(logits.dtype)
        weights = logits * there
        return weights + there * (1 - weights.sum(1, keepdim=True)) / there.sum()
