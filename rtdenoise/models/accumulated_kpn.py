"""The denoiser that ships: kernel prediction over an accumulated, demodulated signal.

What it keeps of `temporal_kpn` (the paper): dual motion vectors, per-pixel kernels at several scales composed from
coarse to fine, a temporal kernel, one explicit step. What it changes: textures are divided out before anything is
filtered and given back before a small kernel smooths edges and the previous output, looked up cubically, is blended in;
noisy light is averaged along tested reprojections before it is filtered, as far as the network trusts it; the network
runs at half size; five scales reach far enough for light as sparse as one sample a pixel leaves it; and where a model
has pick kernels, light that was averaged at a coarser scale stays on its side of an edge.
Read `AccumulatedKPN.step` first.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known, mean_distance
from ..ops import apply_kernel, compose, downsample, pick, reproject, warp
from ..ops.blend_history import blend_history
from ..ops.features import features
from ..ops.pixels import accumulate, demodulate, modulate, nearness
from ..ops.shares import shares
from ..sanitise import admit
from ..splat import history_motion
from .inference import as_weights
from .unet import ConvRelu, UNet

# Noisy 3, its running mean 3, previous output 3, albedo 3, its running mean 3, normal 3, nearness 1, history length 1,
# uncovered 1.
FEATURES = 21
FIRST = slice(0, 3), slice(6, 19)  # of these, what is not zero everywhere in a first frame


@dataclass(frozen=True)
class Config:
    """What defines a model. Stored inside its weights file."""

    widths: tuple[int, ...] = (24, 40, 56, 72, 96)
    """Channels of the U-Net at 1/2, 1/4, 1/8 ... of the image size."""
    scales: int = 5
    """Scales that are filtered: 1, 1/2, 1/4 ... of the image size."""
    kernel: int = 5
    """Side of the spatial kernels, odd."""
    temporal_kernel: int = 3
    """Side of the temporal kernel, odd."""
    edge_kernel: int = 1
    """Side of the kernel that smooths edges, odd; 1: there is none."""
    pick_kernel: int = 1
    """Side of the kernels by which pixels pick from the next coarser scale, odd; 1: there are none."""
    longest: float = 16.0
    """Frames after which the running mean forgets: its least weight of a new frame is 1 / longest."""
    motion: str = "dual"
    """What history is fetched with: 'dual' or 'traditional' motion vectors."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "widths", tuple(self.widths))
        if not 2 <= self.scales <= len(self.widths):
            raise ValueError(f"expected 2 to {len(self.widths)} scales for widths {self.widths}, got {self.scales}")
        for size in (self.kernel, self.temporal_kernel, self.edge_kernel, self.pick_kernel):
            if size % 2 == 0 or size < 1:
                raise ValueError(f"expected odd kernel sizes, got {size}")
        if self.longest < 2:
            raise ValueError(f"expected a longest mean of 2 frames or more, got {self.longest}")
        if self.motion not in ("dual", "traditional"):
            raise ValueError(f"expected motion 'dual' or 'traditional', got {self.motion!r}")

    @property
    def full_head(self) -> list[int]:
        """Outputs of the head at full size: logits of the spatial, temporal and edge kernel, the pick kernel and its
        share, and three shares more. 0 of what there is none of."""
        edge = self.edge_kernel**2 if self.edge_kernel > 1 else 0
        return [self.kernel**2, self.temporal_kernel**2, edge, *self._pick, 3]

    @property
    def coarse_heads(self) -> list[list[int]]:
        """Outputs of the heads of the coarser scales: logits of the spatial kernel, α, and but for the coarsest scale
        the pick kernel and its share."""
        return [[self.kernel**2, 1, *self._pick]] * (self.scales - 2) + [[self.kernel**2, 1, 0, 0]]

    @property
    def _pick(self) -> tuple[int, int]:
        return (self.pick_kernel**2, 1) if self.pick_kernel > 1 else (0, 0)


@dataclass(frozen=True)
class Past:
    """What the frames before say of each pixel. Zero where they say nothing."""

    light: Tensor  # [B, 3, H, W] running mean of irradiance
    albedo: Tensor  # [B, 3, H, W] running mean of albedo
    length: Tensor  # [B, 1, H, W] frames in these means
    output: Tensor  # [B, 3, H, W] the previous output, reprojected; the noisy radiance where it was off the screen
    on_screen: Tensor  # [B, 1, H, W] bool: where it was not
    uncovered: Tensor  # [B, 1, H, W] bool: just uncovered by a moving object


@dataclass(frozen=True)
class Heads:
    """What the network predicts for one frame. Lists run from the finest scale to the coarsest."""

    spatial: list[Tensor]  # `scales` × [B, K², H/2^s, W/2^s] logits of the spatial kernels, the first by cells
    alpha: list[Tensor]  # (scales - 1) × [B, 1, H/2^s, W/2^s] in [0, 1], for s = 1 ...: weight of the coarser scale
    picks: list[tuple[Tensor, Tensor]]  # (scales - 1) × [B, P², H/2^s, W/2^s] logits of the pick kernels, the first by
    # cells, and [B, 1, H/2^s, W/2^s] in [0, 1], the weight of what is picked; empty: there are none
    temporal: Tensor  # [B, 2, 2, L², H/2, W/2] logits of the temporal kernel, by cells (`apply_kernel`)
    edge: Tensor | None  # [B, 2, 2, E², H/2, W/2] logits of the edge kernel, by cells; None: there is none
    alpha_temporal: Tensor  # [B, 1, H, W] in [0, 1]: weight of the current frame against denoised history
    reset: Tensor  # [B, 1, H, W] in [0, 1]: how far the running mean of light is given up for the current frame
    sharp: Tensor  # [B, 1, H, W] in [0, 1]: weight of the current albedo against its running mean


class AccumulatedKPN(nn.Module):
    """The network and its one-frame step. State is explicit: what `step` returns goes into the next `step`."""

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.stem = ConvRelu(FEATURES, config.widths[0], 4, stride=2, padding=1)
        self.unet = UNet(config.widths[0], config.widths)
        outputs, full = [sum(head) for head in config.coarse_heads], sum(config.full_head)
        self.full_head = nn.ConvTranspose2d(config.widths[0], full, 2, stride=2)  # of the four pixels in each cell
        self.heads = nn.ModuleList(nn.Conv2d(w, n, 1) for w, n in zip(config.widths, outputs, strict=False))
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)
        with torch.no_grad():
            self.full_head.bias[-2] = -4.0  # start from a plain running mean: reset near 0
            _start_kernels(self)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """Denoise one frame, as `TemporalKPN.step`."""
        frame = admit(frame, history and history.radiance, known)
        noisy = demodulate(frame.radiance, frame.albedo, frame.depth)  # irradiance, but for what is not diffuse

        past = self.reprojected(frame, history, known)
        most, kept = self.config.longest - 1, torch.zeros_like(past.length)
        mean_albedo = frame.albedo
        if not known.first:
            mean_albedo, _ = accumulate(frame.albedo, past.albedo, past.length, kept, most)

        # Predict kernels.
        heads = self.predict(self.features(frame, noisy, mean_albedo, past, known))

        # Average light over time, but give the mean up where the network says that light has changed.
        if known.first:  # there is nothing to average
            mean, length = noisy, torch.ones_like(past.length)
        else:
            mean, length = accumulate(noisy, past.light, past.length, heads.reset, most)

        # Filter each scale with its own kernels, the coarser ones what the finer have filtered; compose back (eq. 4).
        filtered = [apply_kernel(mean, heads.spatial[0])]
        for logits in heads.spatial[1:]:
            filtered.append(apply_kernel(downsample(filtered[-1]), logits))
        # Composition mixes what lies on either side of an edge; there a pixel picks its own side.
        output = filtered[-1]
        for s in reversed(range(self.config.scales - 1)):
            coarse, output = output, compose(filtered[s], output, heads.alpha[s])
            if heads.picks:
                output = pick(output, coarse, *heads.picks[s])

        # Give the texture back. Albedo has one sample a pixel too: its mean is nearer to a converged picture, but for
        # what has just changed. At an edge the one sample saw one side only: neighbours have seen the other. Then blend
        # with the previous output, which averages edges as well.
        output = modulate(output, frame.albedo, mean_albedo, heads.sharp, frame.depth)
        if heads.edge is not None:
            output = apply_kernel(output, heads.edge)
        output = blend_history(output, past.output, past.on_screen, heads.temporal, heads.alpha_temporal)
        return output, History(output, frame.motion_next, frame.depth, frame.normal, length, mean, mean_albedo)

    def reprojected(self, frame: Frame, history: History | None, known: Known = NOTHING_KNOWN) -> Past:
        """History where this frame needs it: means from the same surface only, the previous output from wherever."""
        if history is None:
            nothing = torch.zeros_like(frame.radiance)
            never = torch.zeros_like(nothing[:, :1], dtype=torch.bool)
            return Past(nothing, nothing, nothing[:, :1], frame.radiance, never, never)
        kind = "traditional" if known.covered else self.config.motion
        motion, seen, uncovered = history_motion(frame, history, kind)
        kept = history.mean, history.mean_albedo, history.length
        here, before = (frame.depth, frame.normal), (history.depth, history.normal)
        light, albedo, length = reproject(kept, motion, here, before)[0].split([3, 3, 1], dim=1)
        output = history.radiance if known.still else warp(history.radiance, motion, seen, frame.radiance, cubic=True)
        return Past(light, albedo, length, output, seen, uncovered)

    def features(
        self, frame: Frame, noisy: Tensor, mean_albedo: Tensor, past: Past, known: Known = NOTHING_KNOWN
    ) -> Tensor:
        """The network's input `[B, 21, H, W]` as its weights are stored: light compressed at one exposure, nearness and
        length in [0, 1]; in a first frame only `FIRST` of it."""
        scale = exposure(noisy) if known.exposure is None else known.exposure
        distance = mean_distance(frame.depth) if known.distance is None else known.distance
        geometry = frame.albedo, mean_albedo, frame.normal, nearness(frame.depth, distance)
        if known.first:
            return features((noisy, past.output), geometry, scale, self.stem.weight)
        time = past.length / self.config.longest, past.uncovered
        return features((noisy, past.light, past.output), (*geometry, *time), scale, self.stem.weight)

    def statistics(self, frame: Frame) -> tuple[Tensor, Tensor]:
        """As `TemporalKPN.statistics`, of the light without its textures."""
        noisy = demodulate(frame.radiance, frame.albedo, frame.depth)
        return exposure(noisy), mean_distance(frame.depth)

    def predict(self, features: Tensor) -> Heads:
        """Run the network at half size. Logits keep its dtype: `apply_kernel` computes in float32 whatever that is."""
        H, W = features.shape[2:]
        x = F.pad(features, (0, W % 2, 0, H % 2), mode="replicate") if W % 2 or H % 2 else features
        levels = self.unet(self._stem(x), self.config.scales - 1)
        spatial, temporal, edge, pick_logits, pick_share, each = self._full_head(levels[0], self.config.full_head)
        heads = zip(self.heads, levels, self.config.coarse_heads, strict=True)
        coarser = [head(x).split(sizes, dim=1) for head, x, sizes in heads]
        kernels, alphas, picks, pick_shares = zip(*coarser, strict=True)
        kernels, alphas = [spatial, *kernels], [alpha.float().sigmoid() for alpha in alphas]
        if pick_logits is None:
            picks = []
        else:
            pick_shares = [shares(pick_share, (H, W)), *(share.float().sigmoid() for share in pick_shares[:-1])]
            picks = list(zip([pick_logits, *picks[:-1]], pick_shares, strict=True))
        return Heads(kernels, alphas, picks, temporal, edge, *shares(each, (H, W)).split(1, dim=1))

    def _full_head(self, x: Tensor, sizes: list[int]) -> list[Tensor | None]:
        """The outputs of `full_head` by cells, `[B, 2, 2, size, H/2, W/2]` for each of `sizes`, so that what is used
        together lies together: a transposed convolution whose stride is its size is one of 1×1 for each pixel. None for
        a size of 0."""

        def part(weight: Tensor, bias: Tensor) -> Tensor | None:
            C, size = weight.shape[:2]
            if size == 0:
                return None
            weight = weight.permute(2, 3, 1, 0).reshape(4 * size, C, 1, 1)
            return F.conv2d(x, weight, bias.repeat(4)).unflatten(1, (2, 2, size))

        head = self.full_head
        weights, biases = head.weight.split(sizes, dim=1), head.bias.split(sizes)
        return [part(weight, bias) for weight, bias in zip(weights, biases, strict=True)]

    def _stem(self, x: Tensor) -> Tensor:
        """The first convolution with its ReLU, of all features or of `FIRST`, to `[B, C, H/2, W/2]`. Pictures smaller
        than its kernel get some of its zero padding beforehand: in half precision oneDNN (torch 2.13) reads memory that
        is not theirs."""
        H, W = x.shape[2:]
        if min(H, W) < 4:
            x = F.pad(x, (0, max(0, 4 - W), 0, max(0, 4 - H)))
        if x.shape[1] == FEATURES:
            return self.stem(x)[:, :, : H // 2, : W // 2]
        # Joined from slices: a list of indices would be copied to the GPU, which a CUDA graph does not allow.
        weight = as_weights(torch.cat([self.stem.weight[:, part] for part in FIRST], dim=1), self)
        return F.relu(F.conv2d(x, weight, self.stem.bias, stride=2, padding=1))[:, :, : H // 2, : W // 2]


def _start_kernels(network: AccumulatedKPN) -> None:
    """Let edge and pick kernels begin as the same everywhere: of 3×3 edge kernels 0.71 lies on the pixel itself, of
    pick kernels 0.48 on the cell that the pixel is in, and 0.12 of the light is picked."""
    # The logit in the middle of each part of the heads, and None for what begins at random.
    full = (None, None, 3.0, 2.0, -2.0, None)  # spatial, temporal and edge kernel, pick kernel, its share, shares
    coarse = (None, None, 2.0, -2.0)  # spatial kernel, α, pick kernel, its share
    starts = [(network.full_head, 1, network.config.full_head, full)]
    sizes = network.config.coarse_heads
    starts += [(head, 0, n, coarse) for head, n in zip(network.heads, sizes, strict=True)]
    for head, axis, sizes, middles in starts:
        parts = zip(head.weight.split(sizes, axis), head.bias.split(sizes), middles, strict=True)
        for weight, bias, middle in parts:
            if middle is not None and len(bias):
                weight.zero_()
                bias.zero_()
                bias[len(bias) // 2] = middle
