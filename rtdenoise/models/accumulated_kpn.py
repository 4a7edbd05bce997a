"""The denoiser that ships: kernel prediction over an accumulated, demodulated signal.

It shares with `temporal_kpn` (the paper) dual motion vectors, per-pixel kernels at several scales that are composed
from coarse to fine, a temporal kernel, and one explicit step. Its changes:

- Albedo is divided out before filtering and multiplied back after it. Then an edge kernel smooths edges, and the
  previous output, fetched by a cubic lookup, is blended in.
- Noisy light is averaged along tested reprojections before it is filtered, as far as the network trusts the average:
  as a running mean, or of recent frames that are kept and looked up anew each time (`ops.recall`).
- The network runs at half size. Five scales reach far enough for the sparse light of one sample a pixel.
- Optional heads: pick kernels keep light of a coarser scale on its own side of an edge (`ops.pick`), `detail` takes
  noise out of the finest detail of a scale (`ops.soften`).

Read `AccumulatedKPN.step` first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..constants import RECALL_SAME
from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known, image_of
from ..ops import apply_kernel, compose, downsample, pick, soften
from ..ops.blend_history import blend_history
from ..ops.even_sky import even_sky
from ..ops.features import features
from ..ops.mean_distance import mean_distance
from ..ops.pixels import accumulate, demodulate, modulate, nearness
from ..ops.shares import shares
from ..sanitise import admit
from .config import AccumulatedKPNConfig
from .footprint import footprint, reset_of_footprint
from .inference import as_weights
from .losses import frame_loss
from .moved_light import followed, shifted
from .past import Past, kept, reprojected
from .refinement import GuidedRefinement
from .unet import ConvRelu, HeadsByCells, UNet, by_name, widened

FIRST_FRAME = slice(0, 3), slice(6, 19)  # input channels that are not zero everywhere in a first frame


@dataclass(frozen=True)
class Heads:
    """The predictions of the network for one frame. Lists run from the finest scale to the coarsest; at the finest
    scale logits lie by cells, `[B, 2, 2, channels, H/2, W/2]` (`ops.apply_kernel`)."""

    spatial: list[Tensor]  # `scales` × [B, K², H/2^s, W/2^s] logits of the spatial kernels
    alpha: list[Tensor]  # (scales - 1) × [B, 1, H/2^s, W/2^s] in [0, 1], for s = 1 ...: weight of the coarser scale
    # (scales - 1) × logits of the pick kernels [B, P², H/2^s, W/2^s], and the weight [B, 1, H/2^s, W/2^s] in [0, 1] of
    # the picked light; empty if the network has none
    picks: list[tuple[Tensor, Tensor]]
    # (scales - 1) × [B, 1, H/2^s, W/2^s] in [0, 1]: share of the finest detail that is kept; empty if not predicted
    detail: list[Tensor]
    temporal: Tensor  # [B, 2, 2, L², H/2, W/2] logits of the temporal kernel
    edge: Tensor | None  # [B, 2, 2, E², H/2, W/2] logits of the edge kernel; None where the network has none
    alpha_temporal: Tensor  # [B, 1, H, W] in [0, 1]: weight of the current frame against denoised history
    reset: Tensor  # [B, 1, H, W] in [0, 1]: how far the running mean of light gives way to the current frame
    sharp: Tensor  # [B, 1, H, W] in [0, 1]: weight of the current albedo against its running mean

    def giving_way(self, past: Past) -> Heads:
        """With as much less of history as does not stay: of light, and of the denoised picture."""
        alpha, reset = (past.giving_way(x) for x in (self.alpha_temporal, self.reset))
        return replace(self, alpha_temporal=alpha, reset=reset)


@dataclass(frozen=True)
class Kernels:
    """What filtered the light of one frame."""

    heads: Heads
    past: Past
    reset: Tensor  # [B, 1, H, W] as the network said; `heads` give way to turns and to what is outdated as well

    @cached_property
    def trust(self) -> Tensor:
        """How far to trust pictures that know history, `[B, 1, H, W]` in [0, 1]: not at all where the network resets
        it; half where only `Past.stays` says that it gives way, as there the kernels' light has given way already; and
        wholly where no history is held."""
        return 1 - self.past.held * (1 - (1 - self.reset) * (1 + self.past.stays) / 2)


class AccumulatedKPN(nn.Module):
    """The network and its one-frame step, a `models.Denoiser`."""

    loss = staticmethod(frame_loss)

    def __init__(self, config: AccumulatedKPNConfig) -> None:
        super().__init__()
        self.config = config
        self.keeps_trust = False  # in its history (`History.trusted`), for pictures that are settled
        self.stem = ConvRelu(config.features, config.widths[0], 4, stride=2, padding=1)
        self.unet = UNet(config.widths[0], config.widths)
        outputs = [sum(config.channels(scale)) for scale in range(1, config.scales)]
        self.full_head = HeadsByCells(config.widths[0], config.channels(0))
        self.heads = nn.ModuleList(nn.Conv2d(w, n, 1) for w, n in zip(config.widths, outputs, strict=False))
        if config.guided:
            self.refine = GuidedRefinement(config.widths[1])
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                nn.init.xavier_uniform_(module.weight)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        if config.guided:
            nn.init.zeros_(self.refine.out.weight)
        with torch.no_grad():
            self.full_head.bias[-2] = -4.0  # reset starts near 0: a plain running mean
            _start_heads(self)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """Denoise one frame: `[B, 3, H, W]` linear radiance ≥ 0, and the history for the next frame.

        `frame` needs radiance, albedo, normal, depth and, unless `history` is None, motion (`rtdenoise.Frame` has
        shapes and units). `history=None` starts a sequence. Raises InputError where a layer is missing, the history has
        another size, is of another kind of model or none, or `frame` is no Frame of tensors.
        """
        frame = admit(frame, image_of(history), known)
        output, after, _ = self.step_and_kernels(frame, history, replace(known, sanitised=True))
        if not known.part:
            after = followed(frame, history, after, self.config.recent + 1)
        return output, after

    def step_and_kernels(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History, Kernels]:
        """`step`, and the kernels that it applied, for layers beside the picture (`noiseless.step`)."""
        frame = admit(frame, image_of(history), known)
        if history is not None:
            history.require(self.config.carries)
        known = shifted(frame, history, known)
        noisy = demodulate(frame.radiance, frame.albedo, frame.depth)  # irradiance where the surface is diffuse

        past = reprojected(self.config, frame, noisy, history, known)
        most, never = self.config.longest - 1, torch.zeros_like(past.length)
        mean_albedo = frame.albedo
        if not known.first:
            mean_albedo, _ = accumulate(frame.albedo, past.albedo, past.albedo_length, never, most)

        # Predict kernels.
        said = self.predict(self.features(frame, noisy, mean_albedo, past, known))
        heads = said.giving_way(past)

        # Average light over time; the mean gives way where the network says that light has changed.
        if known.first:  # there is nothing to average
            mean, length = noisy, torch.ones_like(past.length)
        else:
            same = RECALL_SAME if self.config.recent else 0.0
            mean, length = accumulate(noisy, past.light, past.length, heads.reset, most, same)

        # Multiply the albedo in: its running mean is closer to a converged picture than one sample a pixel, except
        # where it has just changed.
        output = modulate(self.over_space(mean, heads), frame.albedo, mean_albedo, heads.sharp, frame.depth)
        output = self.over_edges_and_time(output, past.output, past.on_screen, heads)
        output = even_sky(output, frame.radiance, frame.depth)
        after = History(output, frame.motion_next, frame.depth, frame.normal, length, mean, mean_albedo, frame.radiance)
        if self.config.recent:
            reset = torch.zeros_like(frame.depth) if history is None else heads.reset.detach()
            reset = reset if past.passed is None else reset.masked_fill(past.passed, 1)
            recent = kept(self.config, frame, reset, noisy, known.shift), *(history.recent if history else ())
            after = replace(after, recent=recent[: self.config.recent])
        if self.config.footprint:
            reset = reset_of_footprint(self.config, frame, past, said.reset, heads.reset)
            seen, count = footprint(frame, past, reset)
            after = replace(after, footprint=seen, footprint_count=count)
        kernels = Kernels(heads, past, said.reset)
        if self.keeps_trust:
            after = replace(after, trusted=(past.held * kernels.trust).detach())
        return output, after, kernels

    def over_space(self, mean: Tensor, heads: Heads) -> Tensor:
        """Light `[B, C, H, W]` filtered by the spatial kernels: linear in it."""
        # Filter each scale with its own kernels: each takes the filtered image of the finer one. Compose back (eq. 4).
        filtered = [apply_kernel(mean, heads.spatial[0])]
        for logits in heads.spatial[1:]:
            filtered.append(apply_kernel(downsample(filtered[-1]), logits))
        # Composition mixes the two sides of an edge; a pixel there picks the coarse cells of its own side.
        output = filtered[-1]
        for s in reversed(range(self.config.scales - 1)):
            coarse, output = output, compose(filtered[s], output, heads.alpha[s])
            if heads.detail:
                output = soften(output, filtered[s], heads.detail[s])
            if heads.picks:
                output = pick(output, coarse, *heads.picks[s])
        return output

    def over_edges_and_time(self, output: Tensor, past: Tensor, seen: Tensor, heads: Heads) -> Tensor:
        """Radiance `[B, C, H, W]` with smooth edges, blended with the previous output: linear in both. The edge kernel
        smooths edges, whose one sample saw one side only; blending averages them as well."""
        if heads.edge is not None:
            output = apply_kernel(output, heads.edge)
        return blend_history(output, past, seen, heads.temporal, heads.alpha_temporal)

    def features(
        self, frame: Frame, noisy: Tensor, mean_albedo: Tensor, past: Past, known: Known = NOTHING_KNOWN
    ) -> Tensor:
        """The network's input `[B, 21, H, W]` in the dtype of its weights: light compressed at one exposure, nearness
        and length in [0, 1]. In a first frame only the channels of `FIRST_FRAME`. Zeros fill the lanes of the first
        convolution (`ConvRelu.lanes`)."""
        scale = exposure(noisy) if known.exposure is None else known.exposure
        distance = mean_distance(frame.depth) if known.distance is None else known.distance
        geometry = frame.albedo, mean_albedo, frame.normal, nearness(frame.depth, distance)
        if known.first:
            return features((noisy, past.output), geometry, scale, self.stem.weight, lanes=self.stem.lanes)
        time = past.length / self.config.longest, past.uncovered
        light = noisy, past.light, past.output
        return features(light, (*geometry, *time), scale, self.stem.weight, lanes=self.stem.lanes)

    def statistics(self, frame: Frame) -> tuple[Tensor, Tensor]:
        """As `Denoiser.statistics`, with the exposure of demodulated light."""
        noisy = demodulate(frame.radiance, frame.albedo, frame.depth)
        return exposure(noisy), mean_distance(frame.depth)

    def predict(self, features: Tensor) -> Heads:
        """Run the network at half size. Logits keep its dtype; `apply_kernel` computes in float32."""
        H, W = features.shape[2:]
        x = widened(features, H % 2, W % 2) if W % 2 or H % 2 else features
        levels = self.unet(self._stem(x), self.config.scales - 1)
        if self.config.guided:
            albedo = 9 if x.shape[1] >= self.config.features else 6  # first channel: light comes before
            surface = torch.cat([x[:, albedo : albedo + 3], x[:, albedo + 6 : albedo + 10]], dim=1)
            levels[1] = self.refine(levels[1], surface)
        full = {head.name: x for head, x in zip(self.config.heads[0], self.full_head(levels[0]), strict=True)}
        coarser = [
            by_name(head(x), names) for head, x, names in zip(self.heads, levels, self.config.heads[1:], strict=True)
        ]
        alphas = [scale["alpha"].float().sigmoid() for scale in coarser]
        picks = [(full["pick"], shares(full["pick_share"], (H, W)))] if "pick" in full else []
        picks += [(scale["pick"], scale["pick_share"].float().sigmoid()) for scale in coarser if "pick" in scale]
        detail = [shares(full["detail"], (H, W))] if "detail" in full else []
        detail += [scale["detail"].float().sigmoid() for scale in coarser if "detail" in scale]
        spatial = [scale["spatial"] for scale in (full, *coarser)]
        each = shares(full["shares"], (H, W)).split(1, dim=1)
        return Heads(spatial, alphas, picks, detail, full["temporal"], full.get("edge"), *each)

    def _stem(self, x: Tensor) -> Tensor:
        """The first convolution with its ReLU, of all input channels or of `FIRST_FRAME`, to `[B, C, H/2, W/2]`.
        Pictures smaller than its kernel are padded first: in half precision oneDNN (torch 2.13) reads beyond their
        memory."""
        H, W = x.shape[2:]
        if min(H, W) < 4:
            x = F.pad(x, (0, max(0, 4 - W), 0, max(0, 4 - H)))
        if x.shape[1] >= self.config.features:
            return self.stem(x)[:, :, : H // 2, : W // 2]
        # Joined from slices: a CUDA graph cannot copy a list of indices to the GPU.
        weight = as_weights(torch.cat([self.stem.weight[:, part] for part in FIRST_FRAME], dim=1), self)
        return F.relu(F.conv2d(x, weight, self.stem.bias, stride=2, padding=1))[:, :, : H // 2, : W // 2]


def _start_heads(network: AccumulatedKPN) -> None:
    """Initialise the heads that have a `Head.start`: every pixel starts with the same kernel."""
    layers = [(network.full_head, 1), *((head, 0) for head in network.heads)]
    for (layer, axis), heads in zip(layers, network.config.heads, strict=True):
        sizes = [head.channels for head in heads]
        for head, weight, bias in zip(heads, layer.weight.split(sizes, axis), layer.bias.split(sizes), strict=True):
            if head.start is not None:
                weight.zero_()
                bias.zero_()
                bias[head.channels // 2] = head.start
