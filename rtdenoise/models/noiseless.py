"""Layers without noise beside the picture, such as colours and emission: only their edges are as ragged as one sample a
pixel leaves them. They come out as smooth as the picture's own, by the kernels that smoothed those."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import torch
from torch import Tensor

from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..ops import reproject, warp
from ..ops.blend import blend
from ..ops.even_sky import even_sky
from ..ops.pixels import accumulate
from ..splat import history_motion
from .accumulated_kpn import AccumulatedKPN
from .moved_light import followed, shifted

GROUP = 6  # channels at once: fused ops take up to 8, and layers have 3


def step(
    network: AccumulatedKPN,
    frame: Frame,  # sanitised
    layers: Tensor,  # [1, 3M, H, W] ≥ 0
    history: History | None = None,
    known: Known = NOTHING_KNOWN,
) -> tuple[Tensor, Tensor, History]:
    """Denoise one frame: the picture `[1, 3, H, W]`, the layers, and the history for the next frame, which holds in
    `hidden` the running mean of the layers with its length, and the layers that came out.

    As the picture's albedo, a layer is blended with its running mean; then the edge kernel and the temporal kernel
    filter it. Layers that are zero everywhere, now and before, cost nothing.
    """
    known = shifted(frame, history, known)
    image, after, kernels = network.step_and_kernels(frame, history, known)
    past, heads = kernels.past, kernels.heads
    means, length, before = _past(network, frame, layers, history, known, past.on_screen)
    most, never = network.config.longest - 1, torch.zeros_like(length)
    pairs = zip(_groups(layers), _groups(means), strict=True)
    means = [accumulate(now, old, length, never, most) for now, old in pairs]
    outputs = []
    for now, (mean, _), old in zip(_groups(layers), means, _groups(before), strict=True):
        if not (_any(now) or _any(old)):
            outputs.append(now)
            continue
        smooth = network.over_edges_and_time(blend(now, mean, heads.sharp), old, past.on_screen, heads).clamp(min=0)
        outputs += [even_sky(a, b, frame.depth) for a, b in zip(smooth.split(3, 1), now.split(3, 1), strict=True)]
    outputs = torch.cat(outputs, dim=1)
    kept = torch.cat([mean for mean, _ in means] + [means[0][1]], dim=1)
    return image, outputs, followed(frame, history, replace(after, hidden=(kept, outputs)), network.config.recent + 1)


def _past(
    network: AccumulatedKPN, frame: Frame, layers: Tensor, history: History | None, known: Known, on_screen: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The running mean and its length, reprojected from the same surface, and the layers before from any."""
    if history is None:
        return torch.zeros_like(layers), torch.zeros_like(frame.depth), torch.zeros_like(layers)
    kind = "traditional" if known.covered else network.config.motion
    motion = history_motion(frame, history, kind, known.shift)[0]
    surfaces = (frame.depth, frame.normal), (history.depth, history.normal)
    kept, before = history.hidden
    kept = _joined(reproject(x, motion, *surfaces)[0] if _any(x) else x for x in _groups(kept))
    if not known.still:
        before = _joined(warp(x, motion, on_screen, x, cubic=True) if _any(x) else x for x in _groups(before))
    return kept[:, :-1], kept[:, -1:], before


def _groups(x: Tensor) -> Iterator[Tensor]:
    return (part.contiguous() for part in x.split(GROUP, dim=1))


def _joined(groups: Iterable[Tensor]) -> Tensor:
    return torch.cat(list(groups), dim=1)


def _any(x: Tensor) -> bool:
    """Whether there is anything in it; on a GPU looking would mean waiting."""
    return x.device.type != "cpu" or bool(x.any())
