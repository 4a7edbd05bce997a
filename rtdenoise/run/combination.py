"""One picture of a frame on disk from what several denoisers made of it.

A frame on disk has a future. The real-time network runs over it forward in time, backward, and alone; OIDN, or a filter
like it, filters what both passes have seen in its pixels (`passes`). These candidates err in different places, so a
weighted sum of them is closer to the truth than each:

    image = c_0 + Σ_i w_i (c_i - c_0),    Σ_i w_i = 1,    in log(1 + exposure · light)

The weight of the single frame is negative: forward and backward pass share the noise of the frame itself, and the
single frame shows it. Where all candidates are equal the image equals them to the bit. The weights are constant: by
trust in history, by what the noisy frame tells, by length of history, or from a network they gained nothing on other
scenes (docs/notes/offline.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..color import compress, expand
from ..exposure import exposure

WEIGHTS = {"forward": 0.4, "backward": 0.4, "single": -0.3, "opinion": 0.5}
MARGIN = 0.5  # of the candidates' range: the image leaves that range by no more


@dataclass(frozen=True)
class Candidates:
    """What is known of one frame, `[1, 3, H, W]` linear radiance each."""

    forward: Tensor  # the network with the frames before as history
    backward: Tensor  # the network with the frames after
    single: Tensor  # the network without history
    opinion: Tensor  # the filter's picture


@dataclass(frozen=True)
class Combination:
    """A combined frame."""

    image: Tensor  # [1, 3, H, W] linear radiance, not negative
    spread: Tensor  # [1, 1, H, W] radiance: Σ |w_i| |c_i - image|, how far the candidates are from the image


def combine(candidates: Candidates) -> Combination:
    """The weighted sum of the candidates; the equation stands above."""
    images = {name: getattr(candidates, name) for name in WEIGHTS}
    first, scale = candidates.forward, exposure(candidates.forward)
    light = {name: compress(scale * image) for name, image in images.items()}
    base = light["forward"]
    change = sum(weight * (light[name] - base) for name, weight in WEIGHTS.items())

    stacked = torch.stack(list(light.values()))
    low, high = stacked.amin(0), stacked.amax(0)
    margin = MARGIN * (high - low)
    mixed = (base + change).maximum(low - margin).minimum(high + margin).clamp(min=0)
    image = torch.where(change == 0, first, expand(mixed) / scale)
    apart = sum(abs(weight) * (images[name] - image).abs() for name, weight in WEIGHTS.items())
    return Combination(image, apart.mean(1, keepdim=True))
