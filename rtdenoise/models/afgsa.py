"""Denoise single frames by self-attention that features guide.

Yu, Nie, Long, Xu, Zhang, Li: Monte Carlo Denoising via Auxiliary Feature Guided Self-Attention (2021). Every pixel
takes a weighted mean of the pixels in a window around its block (`ops.attend_blocks`), five times. The weights come
from noisy light and features together, the averaged values from light alone: features say which pixels belong together,
and leave no trace of their own.

The preset `afgsa` is the published network with these differences: windows end at the border of the picture, depth is
`ops.pixels.nearness` instead of depth over the greatest depth, light is exposed before its logarithm is taken, and the
learned offsets of keys begin near 0. Heads, offsets, the second ReLU of a block, the layers of the extractors and the
zeros around the last convolutions are those of the authors' code.

Read `GuidedAttention.step` first. History is neither read nor written: every frame is denoised alone.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..color import albedo_divisor, compress, expand
from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..ops import apply_kernel, attend_blocks, compose, downsample
from ..ops.mean_distance import mean_distance
from ..ops.pixels import nearness
from ..sanitise import BRIGHTEST, admit
from .afgsa_config import EXTRACTORS, LIGHT, GuidedAttentionConfig
from .inference import as_weights
from .losses import Loss, temporal_kpn_loss
from .unet import ConvRelu, UNet, by_name

MAX_FEATURES = 5 << 23  # numbers in one layer's output: 168 MB in float32; larger frames are denoised in windows
MAX_LOG = 80.0  # exp of more overflows float32
SLOPE = 0.2  # of the leaky ReLUs in the extractor of features
OFFSETS = 0.02  # deviation of the learned offsets at the start: the authors' 1 outweighs the keys of narrow networks


class GuidedAttention(nn.Module):
    """The network and its one-frame step, a `models.Denoiser`."""

    def __init__(self, config: GuidedAttentionConfig) -> None:
        super().__init__()
        self.config = config
        light, guide = config.inputs
        width, outside = config.width, 0 if config.mirrored else 1
        if config.unet:
            self.unet, width = UNet(light + guide, config.unet), config.unet[0]
        else:
            self.light = Extractor(light, width)
            self.guide = Extractor(guide, width, SLOPE) if guide else None
            self.blocks = nn.ModuleList(AttentionBlock(config) for _ in range(config.blocks))
            self.decoder = nn.Sequential(*(ConvRelu(width, width, 3, padding=outside) for _ in range(2)))
        side, outside = (3, outside) if config.output == "residual" else (1, 0)
        outputs = [sum(config.channels(scale)) for scale in range(len(config.heads))]
        self.heads = nn.ModuleList(nn.Conv2d(width, n, side, padding=outside) for n in outputs)
        for head in self.heads:
            nn.init.xavier_uniform_(head.weight)
            nn.init.zeros_(head.bias)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """Denoise one frame: `[B, 3, H, W]` linear radiance ≥ 0, and a history that holds it.

        `frame` needs radiance, albedo, normal and depth (`rtdenoise.Frame` has shapes and units); `history` is ignored.
        Raises InputError where a layer is missing or `frame` is no Frame of tensors.
        """
        frame = admit(frame, None, known, any_float=True)
        scale, distance = self.statistics(frame) if known.exposure is None else (known.exposure, known.distance)
        light = compress(frame.radiance * scale)
        depth = nearness(frame.depth, distance)
        features = torch.cat([light, (frame.normal + 1) / 2, depth, frame.albedo], dim=1)
        if self.config.output == "residual":
            image = expand(self.filtered(features, light).clamp(0, MAX_LOG)) / scale
        else:
            divisor = albedo_divisor(frame.albedo, frame.depth)
            image = self.filtered(features, frame.radiance / divisor) * divisor
        image = image.clamp(0, BRIGHTEST)
        return image, History(image, None, frame.depth, frame.normal)

    def filtered(self, features: Tensor, light: Tensor) -> Tensor:
        """`light` `[B, 3, H, W]` without its noise; features `[B, 10, H, W]` are all that the network sees. Without
        gradients large pictures are filtered window by window: the same up to rounding."""
        B, _, H, W = features.shape
        grid, reach = self.config.grid, self.config.reach
        if torch.is_grad_enabled() or B * self.config.width * H * W <= MAX_FEATURES:
            return self._filtered(features, light)
        side = max(grid, int((MAX_FEATURES / (B * self.config.width)) ** 0.5 - 2 * reach) // grid * grid)
        out = torch.empty_like(light)
        for top in range(0, H, side):
            for left in range(0, W, side):
                y, x = max(0, top - reach), max(0, left - reach)
                window = (..., slice(y, min(H, top + side + reach)), slice(x, min(W, left + side + reach)))
                part = self._filtered(features[window], light[window])
                core = (..., slice(top, min(H, top + side)), slice(left, min(W, left + side)))
                out[core] = part[..., top - y : min(H, top + side) - y, left - x : min(W, left + side) - x]
        return out

    def _filtered(self, features: Tensor, light: Tensor) -> Tensor:
        outputs = self.predict(features)
        if self.config.output == "residual":
            return light + outputs[0]["residual"].float()
        fine = [light]
        for _ in outputs[1:]:
            fine.append(downsample(fine[-1]))
        filtered = [apply_kernel(image, found["spatial"].float()) for image, found in zip(fine, outputs, strict=True)]
        image = filtered[-1]
        for finer, found in zip(filtered[-2::-1], outputs[:0:-1], strict=True):
            image = compose(finer, image, found["alpha"].float().sigmoid())
        return image

    def predict(self, features: Tensor) -> list[dict[str, Tensor]]:
        """Run the network: the heads of every scale by name, finest first."""
        H, W = features.shape[2:]
        light, guide = self.config.inputs
        features = as_weights(features[:, : light + guide], self)
        if missing := (max(0, 3 - W), max(0, 3 - H)) if min(H, W) < 3 else None:  # 2 pixels are reflected at borders
            features = F.pad(features, (0, missing[0], 0, missing[1]), mode="replicate")
        radius = 1 if self.config.mirrored else 0
        if self.config.unet:
            (x,) = self.unet(features, 1)
        else:
            x = self.light(features[:, :light])
            about = self.guide(features[:, LIGHT:]) if guide else None
            for block in self.blocks:
                x = block(x, about)
            for convolve in self.decoder:
                x = convolve(_reflected(x, radius))
        if self.config.output == "residual":
            return [by_name(self.heads[0](_reflected(x, radius))[:, :, :H, :W], self.config.heads[0])]
        x, outputs = x[:, :, :H, :W], []
        for head, names in zip(self.heads, self.config.heads, strict=True):
            x = downsample(x.float()).to(x.dtype) if outputs else x
            outputs.append(by_name(head(x), names))
        return outputs

    def statistics(self, frame: Frame) -> tuple[Tensor, Tensor]:
        """As `Denoiser.statistics`."""
        return exposure(frame.radiance), mean_distance(frame.depth)

    def loss(
        self,
        image: Tensor,
        frame: Frame,
        previous: tuple[Tensor, Tensor] | None,
        occlusion: Tensor | None,
        scale: Tensor | float,
        huber: float,
    ) -> Loss:
        """As `Denoiser.loss`: L1 of logarithms; no frame is compared with the one before."""
        return temporal_kpn_loss(image, frame.reference, None, None, scale, huber)


class Extractor(nn.Module):
    """Convolutions of several sides over the input, joined; one layer more where `slope` is not 0."""

    def __init__(self, inputs: int, width: int, slope: float = 0.0) -> None:
        super().__init__()
        self.slope = slope
        self.sides = nn.ModuleList(nn.Conv2d(inputs, width, side) for side in EXTRACTORS)
        self.join = nn.Conv2d(len(EXTRACTORS) * width, width, 1)
        self.last = nn.Conv2d(width, width, 1) if slope else None

    def forward(self, x: Tensor) -> Tensor:
        """`[B, inputs, H, W]` to `[B, width, H, W]`."""
        found = []
        for side, convolve in zip(EXTRACTORS, self.sides, strict=True):
            found.append(F.leaky_relu(convolve(_reflected(x, side // 2)), self.slope if side > 1 else 0.0))
        x = F.leaky_relu(self.join(torch.cat(found, dim=1)), self.slope)
        return x if self.last is None else F.leaky_relu(self.last(x), self.slope)


class AttentionBlock(nn.Module):
    """Attention in blocks, then two convolutions, each added to its input."""

    def __init__(self, config: GuidedAttentionConfig) -> None:
        super().__init__()
        width, window = config.width, config.block + 2 * config.halo
        self.options = {"block": config.block, "halo": config.halo, "heads": config.attention_heads}
        self.join = ConvRelu(2 * width, width, 1) if config.guide == "guided" else None
        self.query, self.key, self.value = (nn.Conv2d(width, width, 1, bias=False) for _ in range(3))
        offsets = width // config.attention_heads // 2, window
        self.rows, self.columns = (nn.Parameter(OFFSETS * torch.randn(offsets)) for _ in range(2))
        self.first, self.second = (ConvRelu(width, width, 3) for _ in range(2))

    def forward(self, x: Tensor, guide: Tensor | None) -> Tensor:
        """`[B, width, H, W]` and the guide likewise to `[B, width, H, W]`."""
        joined = x if self.join is None else self.join(torch.cat([x, guide], dim=1))
        queries, keys = self.query(joined), self.key(joined)
        del joined
        x = x + attend_blocks(queries, keys, self.value(x), self.rows, self.columns, **self.options)
        del queries, keys
        return x + self.second(_reflected(self.first(_reflected(x, 1)), 1))


def _reflected(x: Tensor, radius: int) -> Tensor:
    """The picture with its border mirrored, `radius` pixels wide."""
    return F.pad(x, (radius,) * 4, mode="reflect") if radius else x
