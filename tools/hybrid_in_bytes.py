"""Make the weights in bytes (`models/in_bytes.py`) of a `hybrid`.

python tools/hybrid_in_bytes.py MODEL OUT SEQ ...    # MODEL: hybrid, hybrid-fast or a file of weights

SEQ are folders of frames such as the denoiser will see, without references. Their first FRAMES are denoised to see what
reaches each layer.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from itertools import islice
from pathlib import Path

import torch
from safetensors.torch import save
from torch import Tensor
from torch.nn import Module
from torch.nn import functional as F

from rtdenoise.data.sequences import open_sequence
from rtdenoise.files import write_atomically
from rtdenoise.models import read
from rtdenoise.models.hybrid import UNIT, Hybrid
from rtdenoise.models.in_bytes import layout
from rtdenoise.models.inference import enlarging
from rtdenoise.ops.convolve_bytes import packed
from rtdenoise.ops.feature_bytes import ALBEDO, CHANNELS, LIGHT, NORMAL, feature_bytes

FRAMES = 6  # of a sequence and signal
SAMPLES = 6000  # windows of a frame and layer
ROOM = 1.25  # what a channel's bytes hold at most, as a multiple of the most that was seen
RARE = 1e-4  # share of a frame's pixels that may show more
DAMPING = 0.003  # added to the variance of each input, as a share of their mean
WHOLE = 127  # the greatest weight
INPUT, INPUTS = "input", 9  # of the network: its name here, its channels


@torch.no_grad()
def main(model: str, out: str, *sequences: str) -> None:
    torch.manual_seed(0)
    network = read(model)
    seen = Seen(network)
    for folder in sequences:
        for signal in ("color", "indirect"):
            history = None
            for frame in islice(open_sequence(folder, signal=signal), FRAMES):
                _, history = network.step(frame, history)
    tensors = {}
    for name, sources in seen.sources.items():
        phases = [rounded(*seen.layer(name, phase)) for phase in range(len(sources) ** 2)]
        step = 1.0 if name == "decoder.0.2" else seen.steps(name)  # that layer makes numbers as they are
        weights = [whole.split([C * K * K for C, K in sources], dim=1) for whole, _, _ in phases]
        tensors |= {
            f"{name}.weight": torch.stack([
                packed([part.reshape(-1, C, K, K) for part, (C, K) in zip(parts, sources, strict=True)])
                for parts in weights
            ]),
            f"{name}.factor": torch.stack([factor for _, factor, _ in phases]).float() / step,
            f"{name}.bias": torch.stack([bias for _, _, bias in phases]).float() / step,
        }  # fmt: skip
    write_atomically(Path(out), save(tensors, metadata={"config": json.dumps(asdict(network.config))}))


class Seen:
    """What reached each layer of the network that writes pixels. Phases are those of `convolve_bytes`."""

    def __init__(self, network: Hybrid) -> None:
        pixels, last = network.pixels, len(network.pixels.encoder) - 1
        self.layers: dict[str, Module] = {f"encoder.{i}": layer for i, layer in enumerate(pixels.encoder)}
        self.makers = {f"encoder.{i}": [f"encoder.{i - 1}" if i else INPUT] for i in range(last + 1)}
        for i, up in enumerate(pixels.decoder):
            self.layers |= {f"decoder.{i}.0": up[0], f"decoder.{i}.2": up[2]}
            below = f"encoder.{last}" if i + 1 == len(pixels.decoder) else f"decoder.{i + 1}.2"
            self.makers[f"decoder.{i}.0"] = [below, f"encoder.{i}" if i else INPUT]
            self.makers[f"decoder.{i}.2"] = [f"decoder.{i}.0"]
        self.sources = {name: sources for name, (sources, _) in layout(network.config).items()}
        # Σ x xᵀ of the windows x of a layer and phase, with 1 in the last place
        self.moments: dict[tuple[str, int], Tensor] = {}
        self.most = {name: torch.full((layer.out_channels,), 1e-3) for name, layer in self.layers.items()}
        pixels.register_forward_pre_hook(self._begin)
        for name, layer in self.layers.items():
            layer.register_forward_hook(lambda _, inputs, output, name=name: self._add(name, inputs[0], output))

    def steps(self, maker: str) -> Tensor:
        """What 1 of a byte is worth in each channel that a layer makes."""
        return torch.ones(CHANNELS) if maker == INPUT else ROOM * self.most[maker] / 255

    def layer(self, name: str, phase: int) -> tuple[Tensor, Tensor, Tensor]:
        """For bytes: weights `[O, inputs]`, bias `[O]` and moments `[inputs + 1, inputs + 1]` of a layer."""
        weight, parts, steps = self.layers[name].weight.double(), [], []
        for maker, (channels, taps) in zip(self.makers[name], self.sources[name], strict=True):
            if taps == 2:
                part, weight = of_phase(weight[:, :channels], phase), weight[:, channels:]
            else:
                part = of_bytes(weight) if maker == INPUT else weight
            steps.append(self.steps(maker).double().repeat_interleave(taps * taps))
            parts.append(part.flatten(1) * steps[-1])
        steps = torch.cat([*steps, torch.ones(1)])
        moments = self.moments[name, phase] / steps / steps[:, None]
        return torch.cat(parts, dim=1), self.layers[name].bias.double(), moments

    def _begin(self, _: Module, inputs: tuple[Tensor, ...]) -> None:
        self.input = feature_bytes(*inputs).float()

    def _add(self, name: str, x: Tensor, output: Tensor) -> None:
        H, W = x.shape[2:]
        most = output[0].flatten(1).topk(1 + int(RARE * H * W)).values[:, -1]
        self.most[name] = torch.maximum(self.most[name], most)
        if self.makers[name][-1] == INPUT:
            given = F.pad(self.input, (0, W - self.input.shape[3], 0, H - self.input.shape[2]))
            x = torch.cat([x[:, :-INPUTS], given], dim=1)
        if len(self.sources[name]) == 1:
            self._count(name, 0, F.unfold(x, 3, padding=1)[0])
            return
        channels = self.sources[name][0][0]
        below, fine = x[:, :channels, ::2, ::2], F.unfold(x[:, channels:], 3, padding=1)[0].unflatten(1, (H, W))
        for phase in range(4):
            a, b = divmod(phase, 2)
            coarse = F.unfold(F.pad(below, (1 - b, b, 1 - a, a)), 2)[0]
            self._count(name, phase, torch.cat([coarse, fine[:, a::2, b::2].flatten(1)]))

    def _count(self, name: str, phase: int, x: Tensor) -> None:
        x = x[:, torch.randint(x.shape[1], (SAMPLES,))]
        x = torch.cat([x, torch.ones_like(x[:1])])
        self.moments[name, phase] = self.moments.get((name, phase), 0) + (x @ x.T).double()


def of_phase(weight: Tensor, phase: int) -> Tensor:
    """Weights `[O, I, 3, 3]` of an enlarged picture to those of the picture before, `[O, I, 2, 2]`, for the pixels at a
    place among 2×2. Pixel i reaches pixel 2i + t - 1 by tap t of `enlarging`."""
    a, b = divmod(phase, 2)
    taps = enlarging(weight).transpose(0, 1)
    return taps[:, :, [3 - a, 1 - a]][..., [3 - b, 1 - b]]


def of_bytes(weight: Tensor) -> Tensor:
    """Weights `[O, 9, 3, 3]` of light, albedo and normal to those of `feature_bytes`."""
    light, albedo, normal = weight.split(3, dim=1)
    light, albedo, normal = light * UNIT / LIGHT, albedo / ALBEDO, normal / NORMAL
    return torch.cat([light, light, albedo, normal, -normal, torch.zeros_like(light[:, :1])], dim=1)


def rounded(weight: Tensor, bias: Tensor, moments: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Whole weights `[O, inputs]` (int8), what 1 of them is worth `[O]`, and the bias that goes with them `[O]`.

    Input by input, that of most variance first, each weight is rounded and its error is taken up by those to come, as
    far as inputs are alike (GPTQ; Frantar et al. 2023, eq. 2 and 3, with the Cholesky factor of the inverse). The bias
    takes up what is left of the mean.
    """
    count = moments[-1, -1]
    mean = moments[:-1, -1] / count
    covariance = moments[:-1, :-1] / count - mean[:, None] * mean
    variance = covariance.diagonal()
    covariance = covariance + torch.eye(len(mean)).double() * DAMPING * variance.mean()

    unit = weight.abs().amax(1, keepdim=True).clamp(min=1e-12) / WHOLE
    order = variance.argsort(descending=True)
    inverse = torch.cholesky_inverse(torch.linalg.cholesky(covariance[order][:, order]))
    upper = torch.linalg.cholesky(inverse, upper=True)
    left, whole = weight[:, order].clone(), torch.zeros_like(weight)
    for i, place in enumerate(order.tolist()):
        now = (left[:, i] / unit[:, 0]).round().clamp(-WHOLE, WHOLE)
        whole[:, place] = now
        left[:, i:] -= (left[:, i] - now * unit[:, 0])[:, None] / upper[i, i] * upper[i, i:]
    return whole.to(torch.int8), unit[:, 0], bias + (weight - whole * unit) @ mean


if __name__ == "__main__":
    main(*sys.argv[1:])
