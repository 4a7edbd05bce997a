"""A denoiser for Metropolis renders: Chen, He, Li: *Denoising of Metropolis light transport with recurrent
transformers* (SIGGRAPH 2024), "the paper" on this page.

Light that was found by mutations of one kind has errors of one kind: a renderer hands it over in K components that add
up to the picture. Each has kernels of its own, spatial and temporal ones at four scales. A U-shaped network of
transformer blocks predicts them; on the way down its blocks also attend to their own features of the frame before.

Read `RecurrentTransformer.step` first. The defaults of `MLTDConfig` are ours: D averages, history that is not valid
has no weight, exposure is the frame's own. The paper's network is

    MLTDConfig(components=4, pool="nearest", invalid="black", normalise="clip", position=True, motion="traditional")

but for two details: D and U stay on one pyramid for odd sizes, and `clip` knows the frames so far, not those to come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..errors import InputError
from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known, image_of
from ..ops import apply_kernel, compose, downsample, reproject, warp
from ..ops.even_sky import even_sky
from ..ops.mean_distance import mean_distance
from ..sanitise import admit
from ..splat import history_motion
from .config import Head
from .inference import as_weights
from .losses import mltd_loss
from .mltd_config import MLTDConfig
from .mltd_input import exposed, spanned
from .transformer import Points, blocks, strips
from .unet import by_name

MAX_HIDDEN = 6e4  # hidden features are carried as float16


@dataclass(frozen=True)
class Past:
    """What the previous frame left, reprojected. Lists run from the finest scale s to the coarsest."""

    light: list[Tensor]  # [B, 3K, H/2^s, W/2^s] filtered components; 0 where not valid
    valid: list[Tensor]  # [B, 1, H/2^s, W/2^s] 1 where the same surface was seen, else 0
    motion: list[Tensor]  # [B, 2, H/2^s, W/2^s] in pixels of the scale
    hidden: tuple[Tensor, ...]  # [B, C, H/2^s, W/2^s] features of each recurrent block, yet to be reprojected

    def features(self, index: int, scale: int, like: Tensor) -> Tensor:
        """The hidden features of a recurrent block, reprojected: 0 where not valid. As large as `like`, which is padded
        to whole cells of the coarsest scale."""
        features = warp(self.hidden[index].float(), self.motion[scale]) * self.valid[scale]
        return _padded(features, like.shape[2:]).to(like.dtype)


class RecurrentTransformer(nn.Module):
    """The network and its one-frame step, a `models.Denoiser`."""

    loss = staticmethod(mltd_loss)

    def __init__(self, config: MLTDConfig) -> None:
        super().__init__()
        self.config = config
        widths, scales = config.widths, range(config.scales)
        self.first = nn.Conv2d(config.features, widths[0], 3, padding=1)
        self.stages = nn.ModuleList(blocks(stage, config.recurrence) for stage in config.stages)
        self.down = nn.ModuleList(nn.Conv2d(w, w // 2, 3, padding=1, bias=False) for w in widths[:-1])
        self.up = nn.ModuleList(nn.Conv2d(2 * w, 4 * w, 3, padding=1, bias=False) for w in widths[:-1])
        self.join = nn.ModuleList(Points(2 * w, w, bias=True) for w in widths)
        self.heads = nn.ModuleList(Points(widths[s], sum(config.channels(s)), bias=True) for s in scales)
        for layer, heads in zip(self.heads, config.heads, strict=True):
            for head, weight, bias in zip(heads, *_rows(layer, heads), strict=True):
                if head.start is not None:
                    nn.init.zeros_(weight)
                    nn.init.constant_(bias, head.start)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """Denoise one frame: `[B, 3, H, W]` linear radiance ≥ 0, and the history for the next frame.

        `frame` needs radiance, albedo, normal, depth, the layers of `config.reads` and, unless `history` is None,
        motion (`rtdenoise.Frame` has shapes and units). `history=None` starts a sequence. Raises InputError where a
        layer is missing, the history has another size, is of another kind of model or none, or `frame` is no Frame of
        tensors.
        """
        frame = admit(frame, image_of(history), known)
        if history is not None:
            history.require(self.config.carries)
        frame.require(*self.config.reads)
        light = [self.components(frame)]
        for _ in range(self.config.scales - 1):
            light.append(downsample(light[-1], self.config.pool))

        # Run the network on what is known of this frame, and on its own hidden features of the frame before.
        past = None if history is None else self.reprojected(frame, history)
        inputs, seen = self.features(frame, light[0], past, history, known)
        features, hidden = self.network(inputs, past)

        # Filter the components at every scale, with history (eq. 5); compose each from coarse to fine (eq. 6); add them
        # (eq. 7).
        filtered, alphas = zip(*(self.filter(s, x, light[s], past) for s, x in enumerate(features)), strict=True)
        image = sum(self.composed([x[:, 3 * k : 3 * k + 3] for x in filtered], [a[:, k : k + 1] for a in alphas])
                    for k in range(self.config.components))  # fmt: skip
        image = even_sky(image.clamp(min=0), frame.radiance, frame.depth)  # eq. 6 subtracts
        return image, History(image, frame.motion_next, frame.depth, frame.normal, hidden=(*filtered, *hidden, *seen))

    def components(self, frame: Frame) -> Tensor:
        """The components, `[B, 3K, H, W]`. One component is all light: where there are more, their sum, in which no
        firefly was dimmed."""
        K, light = self.config.components, frame.components
        if light is None:
            return frame.radiance
        if K == 1:
            return light.unflatten(1, (-1, 3)).sum(1)
        if light.shape[1] != 3 * K:
            raise InputError(f"{frame.name or 'frame'}: expected {K} components, got {light.shape[1] // 3}")
        return light

    def reprojected(self, frame: Frame, history: History) -> Past:
        """History at every scale. A cell is looked up by the motion, and tested by the surface, at its centre."""
        full, seen, _ = history_motion(frame, history, self.config.motion)
        past = Past([], [], [], history.hidden[self.config.scales :])
        for scale, before in enumerate(history.hidden[: self.config.scales]):
            motion = _at_centres(full, scale) / 2**scale
            here = _at_centres(frame.depth, scale), _at_centres(frame.normal, scale)
            there = _at_centres(history.depth, scale), _at_centres(history.normal, scale)
            picture, valid = reproject(before, motion, here, there)
            valid = (valid & _at_centres(seen, scale)).to(picture.dtype)
            picture = picture if self.config.invalid == "excluded" else warp(before, motion)
            past.light.append(picture * valid)
            past.valid.append(valid)
            past.motion.append(motion)
        return past

    def features(
        self, frame: Frame, light: Tensor, past: Past | None, history: History | None, known: Known
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """The network's input `[B, features, H, W]`, and what the next frame needs to scale its own."""
        validity = []
        if self.config.invalid == "excluded":
            validity = [torch.zeros_like(frame.depth) if past is None else past.valid[0]]
        if self.config.normalise == "exposure":
            scales = self.statistics(frame) if known.exposure is None else (known.exposure, known.distance)
            return torch.cat([*exposed(light, frame, *scales, self.config.position), *validity], dim=1), ()
        inputs, most = spanned(light, frame, history and history.hidden[-1], self.config.position)
        return torch.cat([*inputs, *validity], dim=1), (most,)

    def statistics(self, frame: Frame) -> tuple[Tensor, Tensor]:
        """As `Denoiser.statistics`."""
        return exposure(frame.radiance), mean_distance(frame.depth)

    def network(self, inputs: Tensor, past: Past | None) -> tuple[list[Tensor], list[Tensor]]:
        """Features for the heads at every scale, finest first, and the hidden features of the recurrent blocks."""
        size, coarsest = inputs.shape[2:], self.config.scales - 1
        x = self.first(_padded(as_weights(inputs, self), [-(-n // 2**coarsest) * 2**coarsest for n in size]))
        skips, hidden, levels = [], [], []
        stages = list(zip(self.config.stages, self.stages, strict=True))
        for stage, layers in stages[: coarsest + 1]:
            skips.append(x)
            for block in layers:
                before = past.features(len(hidden), stage.scale, x) if past and stage.recurrent else None
                x = block(x, before)
                if stage.recurrent:
                    hidden.append(self.carried(_cropped(x, size, stage.scale)))
            if stage.scale < coarsest:
                x = F.pixel_unshuffle(self.down[stage.scale](x), 2)
        for stage, layers in stages[coarsest + 1 :]:
            x = self.join[stage.scale].of_two(x, skips.pop())
            for block in layers:
                x = block(x)
            levels.insert(0, _cropped(x, size, stage.scale))
            if stage.scale:
                x = F.pixel_shuffle(self.up[stage.scale - 1](x), 2)
        return levels, hidden

    def carried(self, hidden: Tensor) -> Tensor:
        """Hidden features as the next frame gets them. Once trained they are kept as float16: half the memory."""
        return hidden if self.training else hidden.float().clamp(-MAX_HIDDEN, MAX_HIDDEN).half()

    def filter(self, scale: int, features: Tensor, light: Tensor, past: Past | None) -> tuple[Tensor, Tensor]:
        """The filtered components of a scale, `[B, 3K, h, w]` (eq. 5), and α of each, `[B, K, h, w]`; the finest scale
        has no α. In strips: logits are the largest tensors of all."""
        found = []
        for window, _, inner in strips(features, max(self.config.kernel, self.config.temporal_kernel) // 2):
            heads = by_name(self.heads[scale](features[:, :, window]), self.config.heads[scale])
            parts = []
            for k in range(self.config.components):
                colours = slice(3 * k, 3 * k + 3)
                part = apply_kernel(light[:, colours, window], heads[f"spatial{k}"])
                if past is not None:
                    before = past.light[scale][:, colours, window], past.valid[scale][:, :, window]
                    part = self.blend(part, *before, heads[f"temporal{k}"], heads[f"lambda{k}"].float().sigmoid())
                parts.append(part)
            alphas = [heads[f"alpha{k}"].float().sigmoid() for k in range(self.config.components) if scale]
            found.append(torch.cat([*parts, *alphas], dim=1)[:, :, inner])
        K = self.config.components
        return torch.cat(found, dim=2).split([3 * K, K if scale else 0], dim=1)

    def blend(self, light: Tensor, before: Tensor, valid: Tensor, logits: Tensor, share: Tensor) -> Tensor:
        """(1 - λ) · light + λ · Σ κ before (eq. 5). Taps that are not valid are excluded: they leave their part of λ to
        the light of this frame."""
        if self.config.invalid == "black":
            return torch.lerp(light, apply_kernel(before, logits), share)
        past, weight = apply_kernel(torch.cat([before, valid], dim=1), logits).split([3, 1], dim=1)
        return light * (1 - share * weight) + share * past

    def composed(self, filtered: list[Tensor], alphas: list[Tensor]) -> Tensor:
        """One component, from its filtered scales and their shares, finest first (eq. 6)."""
        output = filtered[-1]
        for fine, alpha in zip(filtered[-2::-1], alphas[:0:-1], strict=True):
            output = compose(fine, output, alpha, self.config.pool)
        return output


def _rows(layer: nn.Conv2d, heads: tuple[Head, ...]) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """The weights and biases of each head of a layer."""
    sizes = [head.channels for head in heads]
    return layer.weight.split(sizes), layer.bias.split(sizes)


def _at_centres(image: Tensor, scale: int) -> Tensor:
    """The pixel at the centre of every cell of 2^scale pixels, `[B, C, H, W]` to `[B, C, ⌈H/2^scale⌉, ⌈W/2^scale⌉]`."""
    rows, columns = (
        (torch.arange(0, n, 2**scale, device=image.device) + 2**scale // 2).clamp(max=n - 1) for n in image.shape[2:]
    )
    return image.index_select(2, rows).index_select(3, columns) if scale else image


def _padded(image: Tensor, size: Sequence[int]) -> Tensor:
    """The image with its last row and column repeated up to `size`."""
    below, right = size[0] - image.shape[2], size[1] - image.shape[3]
    return F.pad(image, (0, right, 0, below), mode="replicate") if below or right else image


def _cropped(image: Tensor, size: Sequence[int], scale: int) -> Tensor:
    """The cells of 2^scale pixels that a picture of `size` has."""
    return image[:, :, : -(-size[0] // 2**scale), : -(-size[1] // 2**scale)]
