"""Reaches found by experiment, to hold against those that a configuration states (`rtdenoise.models.config`)."""

from copy import deepcopy
from dataclasses import replace

import torch
from torch import Tensor, nn

from rtdenoise.frame import Frame
from rtdenoise.models.config import CELL
from rtdenoise.models.unet import HeadsByCells


def network_reach(denoiser) -> int:
    """Pixels, rounded up to `CELL`, from which anything can influence an output.

    In a copy with positive weights and no biases, one lit value of the first convolution lights up everything that
    depends on it. The kernels, which the network chooses, add `light_reach`.
    """
    copy, width, furthest = deepcopy(denoiser).float(), 1024, 0
    convolutions = [module for module in copy.modules() if isinstance(module, nn.Conv2d | nn.ConvTranspose2d)]
    for offset in (0, CELL - 1):  # pooling reaches further to one side of a cell
        column, extents = width // 2 + offset, []

        def light(_module, _inputs, output: Tensor, column: int = column) -> Tensor:
            output = torch.zeros_like(output)
            output[..., column * output.shape[-1] // width] = 1e30  # it thins out on its way, but not to nothing
            return output

        def watch(_module, _inputs, output: Tensor, column: int = column, extents: list = extents) -> None:
            lit = (output != 0).any(dim=2).any(dim=1)[0].nonzero().flatten() * width / output.shape[-1]
            extents.append(int((lit - column).abs().max()) + width // output.shape[-1])

        hooks = [convolutions[0].register_forward_hook(light)]
        watched = [layer for layer in convolutions[1:] if not isinstance(layer, HeadsByCells)]  # of one pixel each
        hooks += [convolution.register_forward_hook(watch) for convolution in watched]
        with torch.no_grad():
            for convolution in convolutions:
                convolution.weight.fill_(1 / convolution.weight[0].numel())
                convolution.bias.zero_()
            copy.step(_blank(copy, CELL, width))
        for hook in hooks:
            hook.remove()
        furthest = max(furthest, *extents)
    return _up(furthest + 2) + light_reach(denoiser)  # 2: the first convolution's own


@torch.inference_mode()
def light_reach(denoiser) -> int:
    """Pixels, rounded up to `CELL`, to which one lit pixel of a frame or a history spreads: no weight of a softmax is
    zero."""
    furthest = 0
    for column in (256, 256 + CELL - 1):
        lit, dark = _blank(denoiser, CELL, 512), _blank(denoiser, CELL, 512)
        lit.radiance[..., CELL // 2, column] = 1.0
        _, history = denoiser.step(lit)
        for image in (denoiser.step(lit)[0], denoiser.step(dark, replace(history, radiance=lit.radiance))[0]):
            touched = (image > 0).any(dim=1).any(dim=1)[0].nonzero()
            furthest = max(furthest, int((touched - column).abs().max()))
    return _up(furthest)


def _blank(denoiser, H: int, W: int) -> Frame:
    """A frame of a still, evenly lit wall without light."""

    def flat(channels: int, value: float) -> Tensor:
        return torch.full((1, channels, H, W), value, device=next(denoiser.parameters()).device)

    return Frame(flat(3, 0.0), albedo=flat(3, 0.5), normal=flat(3, 0.5), depth=flat(1, 1.0), motion=flat(2, 0.0),
                 motion_next=flat(2, 0.0))  # fmt: skip


def _up(length: int) -> int:
    return -(-length // CELL) * CELL
