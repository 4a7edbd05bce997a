"""Correct a denoised animation by its noisy frames (deep residual combiner).

After W. Zhou, E. Hughes and T. Hachisuka. y is a noisy, unbiased estimate of a frame, z a denoised, biased one; any
denoiser may have made z from y. The image is z and a weighted sum of residuals y - z of neighbours in space, time and
scale:

    image = z + Σ_{l,j,i} w[l,j,i] · (y - z)[l,j,i]

over scales l, frames j (reprojected to the current one) and taps i. Where y = z the image is z to the bit. The kernels
are softmax-normalised for each frame, and so are the shares of the frames. The preset `combiner` adds to the paper:

- a share of the correction that is applied, since weights that sum to 1 would average noise into pixels that need no
  correction. It begins with the share of `shrinkage` at each scale; the network may lower its logit much and raise it
  little. A free share learns to be 0 before the kernels learn anything (docs/notes/combiner_training.md);
- residuals relative to z: absolute ones do not match across textures and edges of lamps;
- means of residuals in units of their standard errors as input, and a network at half size.

The preset `drc` is the paper's network as far as its available text goes. It lacks the sections on the head and the
pyramid: their equations, 15×15 taps and three scales are reconstructed from the text around them.

Read `Combiner.combine` first.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.utils.checkpoint import checkpoint

from ..exposure import exposure
from ..frame import Frame
from ..ops import apply_kernel, downsample, pick
from ..ops.logits import whole
from ..ops.mean_distance import mean_distance
from ..ops.pixels import nearness
from .combiner_config import CombinerConfig
from .evidence import bounded, certainty, evidence, one_surface, signed_log, statistics
from .inference import as_weights
from .losses import smape_ratio, square_ratio
from .shrinkage import corrected_by_halves
from .unet import ConvRelu, UNet
from .window import Aligned, Combined, Window, aligned, changed, current_of

MAX_LOGITS = 1 << 25  # in memory at once; beyond it, strip by strip, recomputed in the backward pass
LOSS_SCALES = 4  # at which the loss is taken: 1, 1/2 ... of the image size


class Combiner(nn.Module):
    """The network, and `combine`, which applies it to one window."""

    def __init__(self, config: CombinerConfig) -> None:
        super().__init__()
        self.config = config
        inputs = config.features
        if config.half_size:
            self.stem = ConvRelu(inputs, config.widths[0], 4, stride=2, padding=1)
            inputs = config.widths[0]
        self.unet = UNet(inputs, config.widths)
        shapes = config.shapes
        self.heads = nn.ModuleList(
            nn.ModuleDict({h.name: nn.Conv2d(*shapes[f"heads.{s}.{h.name}.weight"][1::-1], 1) for h in heads})
            for s, heads in enumerate(config.heads)
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)
        for convolutions, heads in zip(self.heads, config.heads, strict=True):
            for head in (head for head in heads if head.start is not None):
                convolution = convolutions[head.name]
                nn.init.zeros_(convolution.weight)
                with torch.no_grad():
                    convolution.bias.unflatten(0, (-1, head.channels))[:, head.channels // 2] = head.start

    @property
    def offsets(self) -> tuple[int, ...]:
        """Frame numbers of the window relative to the corrected frame."""
        return self.config.offsets

    def combine(self, window: Window) -> Combined:
        """Correct the current frame of a window of `config.frames` frames: the middle one, the last one if causal.

        Layers may be missing: without motion only the current frame is used. A neighbour that is None, or lies beyond
        one, gets no weight. With `config.evidence` z is first corrected by `window.halves`, if there are any, as
        `shrinkage` does it. Raises ValueError where the window has another length or no current frame.
        """
        original = window.estimates
        window = corrected_by_halves(window) if self.config.evidence else window
        frame, estimate = current_of(window, self.config.current, self.config.frames)
        found, scale = aligned(window, self.config.current, relative=self.config.relative)
        now = found[self.config.current]

        levels = self.predict(self.features(frame, found, scale))
        residuals, valid = ([one and getattr(one, part) for one in found] for part in ("residual", "valid"))
        believed = one_surface(frame) if self.config.evidence else None
        correction = now.divisor * self.correct(levels, residuals, valid, believed)

        image = estimate.where(estimate.isfinite().all(1, keepdim=True), now.estimate)
        image = torch.maximum(image + correction, image.clamp(max=0))
        return Combined(image, changed(image, original[self.config.current]))

    def features(self, frame: Frame, aligned: Sequence[Aligned | None], scale: Tensor) -> Tensor:
        """The network's input `[B, config.features, H, W]` in the dtype of its weights; light at the exposure of z."""
        channels = []
        for one in aligned:
            if one is None:
                count = self.config.of_each_frame
                channels.append(frame.radiance.new_zeros(*frame.radiance.shape[:1], count, *frame.size))
                continue
            light = torch.log1p(scale * torch.cat([one.noisy, one.estimate], 1).clamp(min=0))
            channels += [light, *([signed_log(one.residual)] if self.config.residual_input else []), one.valid]
        channels += [frame.albedo, frame.normal, nearness(frame.depth, mean_distance(frame.depth))]
        if self.config.statistics:
            channels += [statistics([one for one in aligned if one is not None]), certainty(frame)]
        return as_weights(torch.cat(channels, dim=1), self)

    def predict(self, features: Tensor) -> list[Tensor]:
        """Run the U-Net: the features that each scale's heads read, finest first."""
        scales = self.config.scales
        if not self.config.half_size:
            return self.unet(features, scales)
        H, W = features.shape[2:]
        pad = (0, max(W % 2, 4 - W), 0, max(H % 2, 4 - H))
        features = F.pad(features, pad, mode="replicate") if any(pad) else features
        levels = self.unet(self.stem(features)[:, :, : (H + 1) // 2, : (W + 1) // 2], max(1, scales - 1))
        return [levels[self.config.level(scale)] for scale in range(scales)]

    def correct(
        self,
        levels: Sequence[Tensor],
        residuals: Sequence[Tensor | None],
        valid: Sequence[Tensor | None],
        believed: Tensor | None,
    ) -> Tensor:
        """g Σ w r, `[B, 3, H, W]`: filter the residuals of every scale, then compose from coarse to fine.

        A coarser scale adds its correction minus the mean of the finer one's; composing corrections instead of images
        is the paper's fusion, without resampling z.
        """
        filtered = []
        for scale, level in enumerate(levels):
            if scale:
                residuals, valid = ([x if x is None else downsample(x) for x in part] for part in (residuals, valid))
            kept = self._filtered(scale, level, residuals)
            if self.config.evidence:
                believed = downsample(believed) if scale else believed
                change = bounded(self._logits(scale, "trust", level, kept.shape[2:]).float(), self.training)
                kept = kept * (evidence(residuals, valid, self.config.current, believed) + change).sigmoid()
            filtered.append(kept)
        correction = filtered[-1]
        for scale in reversed(range(len(levels) - 1)):
            finer, size = filtered[scale], filtered[scale].shape[2:]
            more = correction - downsample(finer)
            logits = self._logits(scale, "pick", levels[scale], size)
            share = self._logits(scale, "pick_share", levels[scale], size).float().sigmoid()
            correction = finer + pick(torch.zeros_like(finer), more, logits, share)
        return correction

    def loss(self, combined: Combined, frame: Frame, estimate: Tensor) -> Tensor:
        """The error of the image as a share of that of z, against `frame.reference`; mean over `LOSS_SCALES` scales.

        The paper takes SMAPE at full size alone. z's error extends over many pixels and the reference's noise does not,
        so coarser scales show z's error more clearly. Squares (`config.squares`) aim at the mean of noisy references,
        and at the measure of `bench/combine.py`.
        """
        scale, total = exposure(frame.reference), 0
        ratio = square_ratio if self.config.squares else smape_ratio
        image, reference = combined.image, frame.reference
        for _ in range(LOSS_SCALES):
            total = total + ratio(image, estimate, reference, scale) / LOSS_SCALES
            image, estimate, reference = (F.avg_pool2d(x, 2, ceil_mode=True) for x in (image, estimate, reference))
        return total

    def _filtered(self, scale: int, level: Tensor, residuals: Sequence[Tensor | None]) -> Tensor:
        """Σ_j s_j Σ_i w_ji r_ji at one scale, `[B, 3, h, w]`."""
        size = next(r.shape[2:] for r in residuals if r is not None)
        logits = self._logits(scale, "shares", level, size).float()
        absent = torch.tensor([r is None for r in residuals], device=logits.device).reshape(1, -1, 1, 1)
        logits = logits.masked_fill(absent, -torch.inf)
        shares = logits.softmax(dim=1)
        total = 0
        for j, (offset, residual) in enumerate(zip(self.config.offsets, residuals, strict=True)):
            if residual is not None:
                total = total + shares[:, j : j + 1] * self._kernel(scale, f"taps{offset:+d}", level, residual)
        return total

    def _kernel(self, scale: int, name: str, level: Tensor, residual: Tensor) -> Tensor:
        """`apply_kernel` with predicted logits, of which at most `MAX_LOGITS` exist at a time."""
        B, _, H, W = residual.shape
        radius = self.config.kernel // 2
        step = self.config.kernel**2 * B * W
        rows = max(2 * radius, MAX_LOGITS // step // 2 * 2)
        if rows >= H:
            return apply_kernel(residual, self._logits(scale, name, level, (H, W)))
        halo = radius + radius % 2  # strips begin at even rows, where cells of logits do
        cell = 2 if level.shape[2] < H else 1

        def strip(level: Tensor, residual: Tensor, top: int) -> Tensor:
            first, last = max(0, top - halo), min(H, top + rows + halo)
            part, features = residual[:, :, first:last], level[:, :, first // cell : -(-last // cell)]
            filtered = apply_kernel(part, self._logits(scale, name, features, part.shape[2:]))
            return filtered[:, :, top - first : top - first + rows]

        tops = range(0, H, rows)
        if torch.is_grad_enabled():
            return torch.cat([checkpoint(strip, level, residual, top, use_reentrant=False) for top in tops], dim=2)
        return torch.cat([strip(level, residual, top) for top in tops], dim=2)

    def _logits(self, scale: int, name: str, level: Tensor, size: Sequence[int]) -> Tensor:
        """One head at one scale, `[B, channels, H, W]` or, for kernels behind a U-Net at half size, by cells."""
        logits = self.heads[scale][name](level)
        if not (self.config.half_size and scale == 0):
            return logits
        logits = logits.unflatten(1, (2, 2, -1))
        return logits if name.startswith(("taps", "pick")) and name != "pick_share" else (
            whole(logits)[:, :, : size[0], : size[1]]
        )  # fmt: skip
