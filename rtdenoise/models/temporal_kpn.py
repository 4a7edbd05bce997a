"""The denoiser: multi-scale kernel prediction with temporal kernels on dual motion vectors.

Zeng, Wang, Xu, Meng: Neural Temporal Denoising for Indirect Illumination ("the paper"). Read `TemporalKPN.step` first:
it is the whole method on one page; everything it calls is in `motion`, `ops` and `nets`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ..color import compress
from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known, mean_distance
from ..ops import apply_kernel, blend, compose, downsample, warp
from ..ops.pixels import nearness
from ..sanitise import admit
from ..splat import history_motion
from .inference import as_weights
from .unet import UNet

SCALES = 3  # 1, 1/2 and 1/4 of the image: "the last three layers" (§4.3)
FEATURES = 13  # noisy radiance 3, albedo 3, normal 3, depth 1, warped previous output 3


@dataclass(frozen=True)
class Config:
    """What defines a model. Stored inside its weights file."""

    widths: tuple[int, ...] = (24, 32, 48, 64, 96)
    """Channels of the U-Net at 1, 1/2, 1/4 ... of the image size."""
    kernel: int = 5
    """Side of the spatial and temporal kernels, odd."""
    pool: str = "mean"
    """D of eq. 4: 'mean', or 'max' as the paper prints it."""
    motion: str = "dual"
    """What history is fetched with: 'dual' or 'traditional' motion vectors (setting A of the paper)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "widths", tuple(self.widths))
        if len(self.widths) <= SCALES:
            raise ValueError(f"expected at least {SCALES + 1} widths, got {self.widths}")
        if self.kernel % 2 == 0 or self.kernel < 1:
            raise ValueError(f"expected an odd kernel size, got {self.kernel}")
        if self.pool not in ("mean", "max"):
            raise ValueError(f"expected pool 'mean' or 'max', got {self.pool!r}")
        if self.motion not in ("dual", "traditional"):
            raise ValueError(f"expected motion 'dual' or 'traditional', got {self.motion!r}")


@dataclass(frozen=True)
class Heads:
    """What the network predicts for one frame. Lists run from the finest scale to the coarsest."""

    spatial: list[Tensor]  # SCALES × [B, K², H/2^s, W/2^s] logits of the spatial kernels
    alpha: list[Tensor]  # (SCALES - 1) × [B, 1, H/2^s, W/2^s] in [0, 1], for s = 1, 2: weight of the coarser scale
    temporal: Tensor  # [B, K², H, W] logits of the temporal kernel
    alpha_temporal: Tensor  # [B, 1, H, W] in [0, 1]: weight of the current frame against history


class TemporalKPN(nn.Module):
    """The network and its one-frame step. State is explicit: what `step` returns goes into the next `step`."""

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.unet = UNet(FEATURES, config.widths)
        taps = config.kernel**2
        outputs = [2 * taps + 1] + [taps + 1] * (SCALES - 1)  # 51, 26, 26
        self.heads = nn.ModuleList(nn.Conv2d(w, n, 1) for w, n in zip(config.widths, outputs, strict=False))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """Denoise one frame: `[B, 3, H, W]` linear radiance, and the history for the next one.

        `frame` needs radiance, albedo, normal, depth and, unless `history` is None, motion. `history=None` starts a
        sequence or resets after a cut. Without `motion_next` in the previous frame it is approximated from this frame's
        motion and both depths. What is `known` is neither looked for nor done in vain.

        Raises InputError where a layer is missing or the history is of another size.
        """
        frame = admit(frame, history and history.radiance, known)

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
        for _ in range(SCALES - 1):
            pyramid.append(downsample(pyramid[-1], self.config.pool))
        filtered = [apply_kernel(image, logits) for image, logits in zip(pyramid, heads.spatial, strict=True)]
        output = filtered[-1]
        for fine, alpha in zip(filtered[-2::-1], heads.alpha[::-1], strict=True):
            output = compose(fine, output, alpha, self.config.pool)

        # Filter the reprojected history with its own kernel and blend.
        output = blend(output, apply_kernel(warped, heads.temporal), heads.alpha_temporal)
        output = output.clamp(min=0)  # eq. 4 subtracts: keep radiance physical
        return output, History(output, frame.motion_next, frame.depth, frame.normal)

    def features(self, frame: Frame, warped: Tensor, known: Known = NOTHING_KNOWN) -> Tensor:
        """The network's input `[B, 13, H, W]`: radiance compressed at one exposure, depth as nearness in [0, 1)."""
        scale, distance = self.statistics(frame) if known.exposure is None else (known.exposure, known.distance)
        noisy, past = compress(frame.radiance * scale), compress(warped * scale)
        return torch.cat([noisy, frame.albedo, frame.normal, nearness(frame.depth, distance), past], dim=1)

    def statistics(self, frame: Frame) -> tuple[Tensor, Tensor]:
        """What is taken from a frame as a whole, `[B, 1, 1, 1]` each: its exposure, and the mean distance of what was
        hit."""
        return exposure(frame.radiance), mean_distance(frame.depth)

    def predict(self, features: Tensor) -> Heads:
        """Run the network. Logits keep its dtype: `apply_kernel` computes in float32 whatever that is."""
        taps = self.config.kernel**2
        levels = self.unet(as_weights(features, self), SCALES)
        fine, *coarser = (head(x) for head, x in zip(self.heads, levels, strict=True))
        spatial, temporal, alpha_temporal = fine.split([taps, taps, 1], dim=1)
        kernels, alphas = zip(*(x.split([taps, 1], dim=1) for x in coarser), strict=True)
        alpha_temporal, *alphas = (a.float().sigmoid() for a in (alpha_temporal, *alphas))
        return Heads([spatial, *kernels], alphas, temporal, alpha_temporal)
