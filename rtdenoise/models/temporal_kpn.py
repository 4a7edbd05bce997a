"""The denoiser: multi-scale kernel prediction with temporal kernels on dual motion vectors.

Zeng, Wang, Xu, Meng: Neural Temporal Denoising for Indirect Illumination ("the paper"). Read `TemporalKPN.step` first:
it is the whole method on one page; all that it calls is in `splat`, `ops` and `unet`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ..color import compress
from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known, image_of
from ..ops import apply_kernel, blend, compose, downsample, warp
from ..ops.even_sky import even_sky
from ..ops.mean_distance import mean_distance
from ..ops.pixels import nearness
from ..sanitise import admit
from ..splat import history_motion
from .config import TemporalKPNConfig
from .inference import as_weights
from .losses import frame_loss
from .unet import UNet, by_name


@dataclass(frozen=True)
class Heads:
    """The predictions of the network for one frame. Lists run from the finest scale to the coarsest."""

    spatial: list[Tensor]  # 3 × [B, K², H/2^s, W/2^s] logits of the spatial kernels
    alpha: list[Tensor]  # 2 × [B, 1, H/2^s, W/2^s] in [0, 1], for s = 1, 2: weight of the coarser scale
    temporal: Tensor  # [B, K², H, W] logits of the temporal kernel
    alpha_temporal: Tensor  # [B, 1, H, W] in [0, 1]: weight of the current frame against history


class TemporalKPN(nn.Module):
    """The network and its one-frame step, a `models.Denoiser`."""

    loss = staticmethod(frame_loss)

    def __init__(self, config: TemporalKPNConfig) -> None:
        super().__init__()
        self.config = config
        self.unet = UNet(config.features, config.widths)
        outputs = [sum(config.channels(scale)) for scale in range(config.scales)]
        self.heads = nn.ModuleList(nn.Conv2d(w, n, 1) for w, n in zip(config.widths, outputs, strict=False))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """Denoise one frame: `[B, 3, H, W]` linear radiance ≥ 0, and the history for the next frame.

        `frame` needs radiance, albedo, normal, depth and, unless `history` is None, motion (`rtdenoise.Frame` has
        shapes and units). `history=None` starts a sequence. Raises InputError where a layer is missing, the history has
        another size, is of another kind of model or none, or `frame` is no Frame of tensors. The paper, §4.
        """
        frame = admit(frame, image_of(history), known)
        if history is not None:
            history.require(self.config.carries)

        # Reproject the previous output; where that is off the screen start from the noise, like a first frame.
        if history is None:
            warped = frame.radiance
        elif known.still:
            warped = history.radiance
        else:
            motion, seen, _ = history_motion(frame, history, "traditional" if known.covered else self.config.motion)
            warped = warp(history.radiance, motion, seen, frame.radiance)

        # Predict kernels.
        heads = self.predict(self.features(frame, warped, known))

        # Filter each scale with its own kernels, then compose from coarse to fine (eq. 4).
        noisy = frame.radiance
        pyramid = [noisy]
        for _ in range(self.config.scales - 1):
            pyramid.append(downsample(pyramid[-1], self.config.pool))
        filtered = [apply_kernel(image, logits) for image, logits in zip(pyramid, heads.spatial, strict=True)]
        output = filtered[-1]
        for fine, alpha in zip(filtered[-2::-1], heads.alpha[::-1], strict=True):
            output = compose(fine, output, alpha, self.config.pool)

        # Filter the reprojected history with its own kernel and blend.
        output = blend(output, apply_kernel(warped, heads.temporal), heads.alpha_temporal)
        output = output.clamp(min=0)  # eq. 4 subtracts: keep radiance physical
        output = even_sky(output, frame.radiance, frame.depth)
        return output, History(output, frame.motion_next, frame.depth, frame.normal)

    def features(self, frame: Frame, warped: Tensor, known: Known = NOTHING_KNOWN) -> Tensor:
        """The network's input `[B, 13, H, W]`: radiance compressed at one exposure, depth as nearness in [0, 1)."""
        scale, distance = self.statistics(frame) if known.exposure is None else (known.exposure, known.distance)
        noisy, past = compress(frame.radiance * scale), compress(warped * scale)
        return torch.cat([noisy, frame.albedo, frame.normal, nearness(frame.depth, distance), past], dim=1)

    def statistics(self, frame: Frame) -> tuple[Tensor, Tensor]:
        """As `Denoiser.statistics`."""
        return exposure(frame.radiance), mean_distance(frame.depth)

    def predict(self, features: Tensor) -> Heads:
        """Run the network. Logits keep its dtype; `apply_kernel` computes in float32."""
        levels = self.unet(as_weights(features, self), self.config.scales)
        full, *coarser = (
            by_name(head(x), names) for head, x, names in zip(self.heads, levels, self.config.heads, strict=True)
        )
        alpha_temporal, *alphas = (
            x.float().sigmoid() for x in (full["alpha_temporal"], *(c["alpha"] for c in coarser))
        )
        return Heads([c["spatial"] for c in (full, *coarser)], alphas, full["temporal"], alpha_temporal)
