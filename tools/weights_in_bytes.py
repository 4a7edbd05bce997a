"""Make what a model that predicts kernels needs for bytes (`models/in_bytes.py`): steps, and the weights of a `hybrid`.

python tools/weights_in_bytes.py MODEL OUT SEQ ...    # MODEL: default, hybrid ... or a file of weights

SEQ are folders of frames such as the denoiser will see, without references. Their first FRAMES are denoised to see what
reaches each layer.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import torch
from safetensors.torch import save
from torch import Tensor
from torch.nn import functional as F
from usage import call

from rtdenoise.constants import PIXELS_UNIT
from rtdenoise.data.opening import open_sequence
from rtdenoise.files import write_atomically
from rtdenoise.models import Denoiser, read
from rtdenoise.models.bytes_layout import INPUT, PIXELS, UNET, Picture, layout, made_for, shapes
from rtdenoise.models.in_bytes import WHOLE, phases
from rtdenoise.models.pixel_network import PixelNetwork
from rtdenoise.models.weights import find
from rtdenoise.ops.convolve_bytes import packed
from rtdenoise.ops.feature_bytes import CHANNELS, LIGHT, SURFACE, feature_bytes

FRAMES = 6  # of a sequence and signal
SAMPLES = 6000  # windows of a frame and layer
ROOM = 1.25  # what a channel's bytes hold at most, as a multiple of the most that was seen
ROOM_OF_SURFACES = 2.0  # the same of networks that filter albedo and normal, whose noise may be far more than was seen
RARE = 1e-4  # share of a frame's pixels that may show more
DAMPING = 0.003  # added to the variance of each input, as a share of their mean
INPUTS = 9  # of the network that writes pixels, as numbers
GIVEN = f"{PIXELS}.{INPUT}"  # its name as a layer


@torch.no_grad()
def main(model: str, out: str, sequence: str, *more: str) -> None:
    torch.manual_seed(0)
    network = read(model)
    seen = Seen(network)
    for folder in (sequence, *more):
        for signal in ("color", "indirect"):
            history = None
            for frame in islice(open_sequence(folder, signal=signal), FRAMES):
                _, history = network.step(frame, history)
    kept, tensors = shapes(network.config), {}
    for name in seen.most:
        if f"{name}.step" in kept:
            tensors[f"{name}.step"] = seen.steps(name)
    for name, layer in seen.layers.items():
        if not layer.careful:
            continue
        found = [rounded_with_care(*seen.layer(name, phase)) for phase in range(layer.phases)]
        step = 1.0 if layer.numbers else seen.steps(name)
        weights = [whole.split([p.channels * p.taps**2 for p in layer.reads], dim=1) for whole, _, _ in found]
        tensors |= {
            f"{name}.weight": torch.stack([
                packed([x.reshape(-1, p.channels, p.taps, p.taps) for x, p in zip(parts, layer.reads, strict=True)])
                for parts in weights
            ]),
            f"{name}.factor": torch.stack([factor for _, factor, _ in found]).float() / step,
            f"{name}.bias": torch.stack([bias for _, _, bias in found]).float() / step,
        }  # fmt: skip
    write_atomically(Path(out), save(tensors, metadata=made_for(find(model))))


class Seen:
    """What reached each layer. Phases are those of `convolve_bytes`."""

    def __init__(self, network: Denoiser) -> None:
        self.layers = layout(network.config)
        self.modules = {name: network.get_submodule(name) for name in self.layers}
        # Σ x xᵀ of the windows x of a layer and phase, with 1 in the last place
        self.moments: dict[tuple[str, int], Tensor] = {}
        self.most: dict[str, Tensor] = {}
        network.unet.register_forward_pre_hook(lambda _, inputs: self._measure(f"{UNET}.{INPUT}", inputs[0]))
        if hasattr(network, PIXELS):
            network.pixels.register_forward_pre_hook(self._begin)
        for name, module in self.modules.items():
            module.register_forward_hook(lambda _, inputs, output, name=name: self._add(name, inputs[0], output))

    def steps(self, maker: str) -> Tensor:
        """What 1 of a byte is worth in each channel that a layer makes."""
        room = ROOM_OF_SURFACES if maker.startswith(f"{PIXELS}.surfaces.") else ROOM
        return torch.ones(CHANNELS) if maker == GIVEN else room * self.most[maker] / 255

    def layer(self, name: str, phase: int) -> tuple[Tensor, Tensor, Tensor]:
        """For bytes: weights `[O, inputs]`, bias `[O]` and moments `[inputs + 1, inputs + 1]` of a layer."""
        parts, steps, reads = [], [], self.layers[name].reads
        channels = [INPUTS if picture.maker == GIVEN else picture.channels for picture in reads]
        for picture, part in zip(reads, phases(self.modules[name].weight.double(), channels)[phase], strict=True):
            if picture.maker == GIVEN:
                part = of_bytes(part)
            steps.append(self.steps(picture.maker).double().repeat_interleave(picture.taps**2))
            parts.append(part.flatten(1) * steps[-1])
        steps = torch.cat([*steps, torch.ones(1)])
        moments = self.moments[name, phase] / steps / steps[:, None]
        return torch.cat(parts, dim=1), self.modules[name].bias.double(), moments

    def _begin(self, network: PixelNetwork, inputs: tuple[Tensor, ...]) -> None:
        lit, albedo, normal = inputs
        if network.surfaces:
            albedo, normal = network.clean(albedo, normal)
        self.given = feature_bytes(lit, albedo, normal).float()

    def _measure(self, name: str, x: Tensor) -> None:
        most = x[0].flatten(1).topk(1 + int(RARE * x.shape[2] * x.shape[3])).values[:, -1].clamp(min=1e-3)
        self.most[name] = torch.maximum(self.most.get(name, most), most)

    def _add(self, name: str, x: Tensor, output: Tensor) -> None:
        self._measure(name, F.relu(output))
        if not self.layers[name].careful:
            return
        *coarser, beside = self.layers[name].reads
        windows = F.unfold(self._read(beside, x), 3, padding=1)[0]
        if not coarser:
            self._count(name, 0, windows)
            return
        below, fine = x[:, : coarser[0].channels, ::2, ::2], windows.unflatten(1, x.shape[2:])
        for phase in range(4):
            a, b = divmod(phase, 2)
            coarse = F.unfold(F.pad(below, (1 - b, b, 1 - a, a)), 2)[0]
            self._count(name, phase, torch.cat([coarse, fine[:, a::2, b::2].flatten(1)]))

    def _read(self, beside: Picture, x: Tensor) -> Tensor:
        """The picture of the layer's own size, the last of what it reads."""
        if beside.maker != GIVEN:
            return x[:, x.shape[1] - beside.channels :]
        return F.pad(self.given, (0, x.shape[3] - self.given.shape[3], 0, x.shape[2] - self.given.shape[2]))

    def _count(self, name: str, phase: int, x: Tensor) -> None:
        x = x[:, torch.randint(x.shape[1], (SAMPLES,))]
        x = torch.cat([x, torch.ones_like(x[:1])])
        self.moments[name, phase] = self.moments.get((name, phase), 0) + (x @ x.T).double()


def of_bytes(weight: Tensor) -> Tensor:
    """Weights `[O, 9, 3, 3]` of light, albedo and normal to those of `feature_bytes`."""
    light, albedo, normal = weight.split(3, dim=1)
    light = light * PIXELS_UNIT / LIGHT
    return torch.cat([light, light, albedo / SURFACE, normal / SURFACE], dim=1)


def rounded_with_care(weight: Tensor, bias: Tensor, moments: Tensor) -> tuple[Tensor, Tensor, Tensor]:
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
    call(main, __doc__)
