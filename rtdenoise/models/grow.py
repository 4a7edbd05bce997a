"""A wider network that computes what a narrower one does, so that training goes on from there.

Chen, Goodfellow, Shlens: Net2Net (ICLR 2016). New channels start as random features that nobody reads: the weights by
which old channels and the heads would read them are zero. Training is what makes them useful. An edge or pick kernel
that was not there before starts as it does in a fresh network, which changes a little.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import nn

from .accumulated_kpn import AccumulatedKPN, Config


def grow(small: AccumulatedKPN, wanted: Config) -> AccumulatedKPN:
    """A network of the configuration `wanted` with the outputs of `small`, up to rounding; new edge and pick kernels
    change them a little.

    `small` is as `read` gives it: `load` rounds weights to run them.

    Raises ValueError where `wanted` is of another kind, differs in anything but widths and new edge and pick
    kernels, or is narrower somewhere.
    """
    if not _fits(small.config, wanted):
        raise ValueError(
            f"expected {small.config}, or wider at any level, or with new edge or pick kernels, got {wanted}"
        )
    was = small.config.widths
    large = AccumulatedKPN(wanted)
    below = {f"unet.decoder.{level}.0": w for level, w in enumerate(zip(was[1:], wanted.widths[1:], strict=True))}
    with torch.no_grad():
        for (name, narrow), wide in zip(small.named_modules(), large.modules(), strict=True):
            if isinstance(narrow, nn.Conv2d):
                _fill(wide, narrow, below.get(name, (0, 0)))
            elif isinstance(narrow, nn.ConvTranspose2d):  # the full head: its weight is [inputs, outputs, 2, 2]
                groups = torch.arange(wide.out_channels).split(wanted.full_head)
                kept = torch.cat([g for g, had in zip(groups, small.config.full_head, strict=True) if had])
                wide.weight[:, kept] = 0
                wide.weight[: narrow.in_channels, kept] = narrow.weight
                wide.bias[kept] = narrow.bias
    return large


def _fits(was: Config, wanted: Config) -> bool:
    if not isinstance(was, Config) or not isinstance(wanted, Config) or len(was.widths) != len(wanted.widths):
        return False
    wider = all(a <= b for a, b in zip(was.widths, wanted.widths, strict=True))
    new = {name: getattr(was, name) for name in ("edge_kernel", "pick_kernel") if getattr(was, name) == 1}
    return wider and replace(wanted, widths=was.widths, **new) == was


def _fill(wide: nn.Conv2d, narrow: nn.Conv2d, below: tuple[int, int]) -> None:
    """Give `wide` the outputs of `narrow`, which read nothing new. `below` are the channels, before and now, that the
    input begins with where it is joined of two pictures."""
    (first, first_now), outputs = below, narrow.out_channels
    second = narrow.in_channels - first
    weight, bias = wide.weight[:outputs].zero_(), wide.bias[:outputs]
    weight[:, :first] = narrow.weight[:, :first]
    weight[:, first_now : first_now + second] = narrow.weight[:, first:]
    bias.copy_(narrow.bias)
