"""A wider network that computes the same as a narrower one, so that training goes on from there.

Chen, Goodfellow, Shlens: Net2Net (ICLR 2016). New channels start as random features with no reader: old channels and
heads read them with zero weights, and training makes them useful. A head that the narrower network lacks starts as in a
fresh network, which changes the output a little.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from .accumulated_kpn import AccumulatedKPN
from .config import AccumulatedKPNConfig, Head
from .presets import Config

WITHOUT = {"edge_kernel": 1, "pick_kernel": 1, "detail": False, "guided": False}  # values of networks without these


def grow(small: AccumulatedKPN, wanted: Config) -> AccumulatedKPN:
    """A network of the configuration `wanted` with the outputs of `small`, up to rounding and the effect of new heads.

    `small` is as `read` gives it: `load` rounds weights to run them.

    Raises ValueError where `wanted` has another architecture, is narrower at a level, or differs in anything but
    widths, new heads and recent frames.
    """
    if not _fits(small.config, wanted):
        raise ValueError(f"expected {small.config}, or wider at any level, or with new heads, got {wanted}")
    large = AccumulatedKPN(wanted)
    widths = zip(small.config.widths[1:], wanted.widths[1:], strict=True)
    below = {f"unet.decoder.{level}.0": pair for level, pair in enumerate(widths)}
    modules = dict(large.named_modules())
    with torch.no_grad():
        for name, narrow in small.named_modules():
            if isinstance(narrow, nn.Conv2d) and not name.startswith(("heads.", "refine.")):
                _copy(modules[name].weight, modules[name].bias, narrow.weight, narrow.bias, *below.get(name, (0, 0)))
        layers = [small.full_head, *small.heads], [large.full_head, *large.heads]
        for narrow, wide, had, has in zip(*layers, small.config.heads, wanted.heads, strict=True):
            _copy_heads(wide, narrow, had, has)
    if small.config.guided:
        large.refine.load_state_dict(small.refine.state_dict())
    return large


def _fits(was: Config, wanted: Config) -> bool:
    if not all(type(c) is AccumulatedKPNConfig for c in (was, wanted)) or len(was.widths) != len(wanted.widths):
        return False
    wider = all(a <= b for a, b in zip(was.widths, wanted.widths, strict=True))
    new = {name: value for name, value in WITHOUT.items() if getattr(was, name) == value}
    wider &= not was.guided or was.widths[1] == wanted.widths[1]  # the attention's heads are not split anew
    same = {"widths": was.widths, "recent": was.recent, "footprint": was.footprint}  # recent frames have no weights
    return wider and replace(wanted, **same, **new) == was


def _copy(
    weight: Tensor,  # [O', I', ...] of the wider layer
    bias: Tensor,  # [O']
    narrow_weight: Tensor,  # [O, I, ...]
    narrow_bias: Tensor,  # [O]
    first: int = 0,  # channels of the first picture where the input joins two, in the narrower network
    first_wide: int = 0,  # and in the wider one
) -> None:
    """Give the first outputs of a layer the values of the narrower one: they read nothing new."""
    outputs, second = len(narrow_bias), narrow_weight.shape[1] - first
    weight, bias = weight[:outputs].zero_(), bias[:outputs]
    weight[:, :first] = narrow_weight[:, :first]
    weight[:, first_wide : first_wide + second] = narrow_weight[:, first:]
    bias.copy_(narrow_bias)


def _copy_heads(wide: nn.Module, narrow: nn.Module, had: tuple[Head, ...], has: tuple[Head, ...]) -> None:
    """Copy the heads of one scale by their names; a transposed convolution's weight is [inputs, outputs, ...]."""

    def parts(layer: nn.Module, heads: tuple[Head, ...]) -> dict[str, tuple[Tensor, Tensor]]:
        weight = layer.weight.transpose(0, 1) if isinstance(layer, nn.ConvTranspose2d) else layer.weight
        sizes = [head.channels for head in heads]
        pairs = zip(weight.split(sizes), layer.bias.split(sizes), strict=True)
        return {head.name: pair for head, pair in zip(heads, pairs, strict=True)}

    new = parts(wide, has)
    for name, old in parts(narrow, had).items():
        _copy(*new[name], *old)
