"""The light of a frame in parts: the kernels that the network predicts from the whole filter each part as well.

The filter is linear in the light once its kernels are known. So parts that add up before add up after, one run of the
network serves all, and each light is divided by a colour of its own (`Parts.color_of`), where the whole knows one
albedo only.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..color import albedo_divisor
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..ops import reproject, warp
from ..ops.blend import blend
from ..ops.even_sky import even_sky
from ..ops.pixels import accumulate
from ..sanitise import BRIGHTEST
from ..splat import history_motion
from .accumulated_kpn import AccumulatedKPN, Kernels
from .past import followed, shifted

GROUP = 6  # channels that are filtered at once: fused ops take up to 8, and pictures have 3
ALBEDO = -1  # a `color_of`: the frame's albedo, as `pixels.demodulate` limits it


@dataclass(frozen=True)
class Output:
    """A sum of parts: Σ light · its colour + Σ passed."""

    lights: tuple[int, ...] = ()
    passed: tuple[int, ...] = ()


@dataclass(frozen=True)
class Parts:
    """The parts of one frame's light, K filtered ones and M that pass the spatial kernels by."""

    lights: Tensor  # [1, 3K, H, W] ≥ 0, divided by their colours, except those of `ALBEDO`, which are not yet
    passed: Tensor  # [1, 3M, H, W] ≥ 0: colours, and light without noise (emission, environment)
    color_of: tuple[int | None, ...]  # K times the colour of a light: a number in `passed`, `ALBEDO`, None for none
    outputs: tuple[Output, ...]  # what to add up


def step(
    network: AccumulatedKPN,
    frame: Frame,  # sanitised; its radiance is the whole
    parts: Parts,
    history: History | None = None,
    known: Known = NOTHING_KNOWN,
) -> tuple[Tensor, Tensor, History]:
    """Denoise one frame and its parts: the whole `[1, 3, H, W]`, the outputs `[1, 3·outputs, H, W]`, and the history
    for the next frame, which holds in `hidden` the running mean of lights, the outputs, and the running mean of passed.

    Parts that are zero everywhere, now and before, cost nothing.
    """
    known = shifted(frame, history, known)
    image, after, kernels = network.step_and_kernels(frame, history, known)
    lights = _divided(parts, frame)
    past = _past(network, frame, parts, history, kernels, known)
    most, kept = network.config.longest - 1, torch.zeros_like(kernels.past.length)
    means, passed = (
        _joined((accumulate(new, old, kernels.past.length, reset, most)[0] for new, old in _pairs(now, before)), now)
        for now, before, reset in ((lights, past[0], kernels.heads.reset), (parts.passed, past[1], kept))
    )

    filtered = _joined((_over_space(network, x, kernels) for x in _groups(means)), means).clamp_(min=0)
    sharp = _joined((blend(a, b, kernels.heads.sharp) for a, b in _pairs(parts.passed, passed)), passed)
    albedo = albedo_divisor(blend(frame.albedo, after.mean_albedo, kernels.heads.sharp), frame.depth)
    noisy = _sums(parts, lights, parts.passed, albedo_divisor(frame.albedo, frame.depth))
    sums = _sums(parts, filtered, sharp, albedo)
    outputs = []
    for new, old, unfiltered in zip(_groups(sums), _groups(past[2]), _groups(noisy), strict=True):
        if not (_any(new) or _any(old)):
            outputs.append(new)
            continue
        edged = network.over_edges_and_time(new, old, kernels.past.on_screen, kernels.heads).clamp(min=0)
        outputs += [even_sky(a, b, frame.depth) for a, b in zip(edged.split(3, 1), unfiltered.split(3, 1), strict=True)]
    outputs = torch.cat(outputs, dim=1)
    after = replace(after, hidden=(means, outputs, passed) if passed.shape[1] else (means, outputs))
    return image, outputs, followed(frame, history, after, network.config.recent + 1)


def _divided(parts: Parts, frame: Frame) -> Tensor:
    """The lights, all divided by their colours now, and limited."""
    divisor = albedo_divisor(frame.albedo, frame.depth)
    each = zip(parts.lights.split(3, 1), parts.color_of, strict=True)
    divided = [light / divisor if color == ALBEDO else light for light, color in each]
    return torch.nan_to_num(torch.cat(divided, 1), nan=0.0, posinf=0.0, neginf=0.0).clamp_(0, BRIGHTEST)


def _past(
    network: AccumulatedKPN,
    frame: Frame,
    parts: Parts,
    history: History | None,
    kernels: Kernels,
    known: Known,
) -> tuple[Tensor, Tensor, Tensor]:
    """The history of lights, passed and outputs, reprojected as `past.reprojected` does. Outputs where
    motion leads off the screen are not used."""
    if history is None:
        sizes = parts.lights.shape[1], parts.passed.shape[1], 3 * len(parts.outputs)
        lights, passed, outputs = (torch.zeros_like(frame.depth).repeat(1, size, 1, 1) for size in sizes)
        return lights, passed, outputs
    kind = "traditional" if known.covered else network.config.motion
    motion = history_motion(frame, history, kind, known.shift)[0]
    here, before = (frame.depth, frame.normal), (history.depth, history.normal)
    lights, outputs, *passed = history.hidden
    passed = passed[0] if passed else parts.passed
    lights, passed = (
        _joined((reproject(x, motion, here, before)[0] if _any(x) else x for x in _groups(mean)), mean)
        for mean in (lights, passed)
    )
    if not known.still:
        moved = (warp(x, motion, kernels.past.on_screen, x, cubic=True) if _any(x) else x for x in _groups(outputs))
        outputs = _joined(moved, outputs)
    return lights, passed, outputs


def _over_space(network: AccumulatedKPN, x: Tensor, kernels: Kernels) -> Tensor:
    return network.over_space(x, kernels.heads) if _any(x) else x


def _sums(parts: Parts, lights: Tensor, passed: Tensor, albedo: Tensor) -> Tensor:
    """Every output `[1, 3·outputs, H, W]`."""
    lights, passed = lights.split(3, 1), passed.split(3, 1)
    sums = []
    for output in parts.outputs:
        total = torch.zeros_like(albedo)
        for i in output.lights:
            color = parts.color_of[i]
            total = total + (lights[i] if color is None else lights[i] * (albedo if color == ALBEDO else passed[color]))
        for i in output.passed:
            total = total + passed[i]
        sums.append(total)
    return torch.cat(sums, dim=1)


def _groups(x: Tensor) -> Iterator[Tensor]:
    """`GROUP` channels at a time; nothing where there are none."""
    return (part.contiguous() for part in x.split(GROUP, dim=1) if part.shape[1])


def _joined(groups: Iterable[Tensor], like: Tensor) -> Tensor:
    """The inverse of `_groups`, with the channels of `like`."""
    return torch.cat([like[:, :0], *groups], dim=1)


def _pairs(x: Tensor, y: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    return zip(_groups(x), _groups(y), strict=True)


def _any(x: Tensor) -> bool:
    """Whether there is anything in it; on a GPU looking would mean waiting."""
    return x.device.type != "cpu" or bool(x.any())
