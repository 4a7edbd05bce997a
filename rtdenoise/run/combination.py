"""One picture of a frame on disk from what several denoisers made of it.

A frame on disk has a future. The real-time network runs over it forward in time, backward, and alone; OIDN, or a filter
like it, filters what both passes have seen in its pixels (`passes`). These candidates err in different places, so a
weighted sum of them is closer to the truth than each:

    image = c_0 + Σ_i w_i (c_i - c_0),    Σ_i w_i = 1,    in log(1 + exposure · light)

The weight of the single frame is negative: forward and backward pass share the noise of the frame itself, and the
single frame shows it. Where all candidates are equal the image equals them to the bit.

A pass counts as far as the network trusts its history there: light that moves on a surface which stands still lags
behind in it. All of its pictures together count as far as the noisy frame tells, too (`ops.mix.share_told`). The
filter's picture takes what is left. Weights by length of history, or from a network, gained nothing on other scenes
(docs/notes/offline.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..color import compress, expand
from ..exposure import exposure
from ..ops.mix import share_told

WEIGHTS = {"forward": 0.2, "backward": 0.2, "single": -0.2, "opinion": 0.8}  # where history is trusted
MARGIN = 0.5  # of the candidates' range: the image leaves that range by no more


@dataclass(frozen=True)
class Candidates:
    """What is known of one frame, `[1, 3, H, W]` linear radiance each."""

    forward: Tensor  # the network with the frames before as history
    backward: Tensor  # the network with the frames after
    single: Tensor  # the network without history
    opinion: Tensor  # the filter's picture
    trust_forward: Tensor | float = 1.0  # [1, 1, H, W] in [0, 1]: of each pass in its history
    trust_backward: Tensor | float = 1.0


@dataclass(frozen=True)
class Combination:
    """A combined frame."""

    image: Tensor  # [1, 3, H, W] linear radiance, not negative
    spread: Tensor  # [1, 1, H, W] radiance: Σ |w_i| |c_i - image|, how far the candidates are from the image


def combine(candidates: Candidates, noisy: Tensor | None = None) -> Combination:
    """The weighted sum of the candidates; the equation stands above. `noisy`: the frame, `[1, 3, H, W]`; without it
    weights are as they are where history is trusted."""
    weights = _trusted(candidates)
    scale, first = exposure(candidates.forward), candidates.forward
    light = {name: compress(scale * getattr(candidates, name)) for name in weights}
    if noisy is not None:
        weights = _told(weights, light, candidates.opinion, noisy, scale)
    base = light["forward"]
    change = sum(weight * (light[name] - base) for name, weight in weights.items())

    stacked = torch.stack(list(light.values()))
    low, high = stacked.amin(0), stacked.amax(0)
    margin = MARGIN * (high - low)
    mixed = (base + change).maximum(low - margin).minimum(high + margin).clamp(min=0)
    image = torch.where(change == 0, first, expand(mixed) / scale)
    apart = sum(abs(weight) * (getattr(candidates, name) - image).abs() for name, weight in weights.items())
    return Combination(image, apart.mean(1, keepdim=True))


def _trusted(candidates: Candidates) -> dict[str, Tensor | float]:
    """`WEIGHTS` of the network's candidates times the trust in each, the rest for the opinion."""
    forward, backward = candidates.trust_forward, candidates.trust_backward
    trust = {"forward": forward, "backward": backward, "single": (forward + backward) / 2}
    weights = {name: WEIGHTS[name] * share for name, share in trust.items()}
    return weights | {"opinion": 1 - sum(weights.values())}


def _told(
    weights: dict[str, Tensor | float], light: dict[str, Tensor], opinion: Tensor, noisy: Tensor, scale: Tensor
) -> dict[str, Tensor | float]:
    """The weights, with those of the network's candidates, which `_trusted` made, as the noisy frame tells."""
    own = {name: weight for name, weight in weights.items() if name != "opinion"}
    together = sum(own.values())
    picture = sum(weight * light[name] for name, weight in own.items()) / (together + (together == 0))
    usual = 1 - WEIGHTS["opinion"]
    share = share_told(noisy, expand(picture.clamp(min=0)) / scale, opinion, scale, usual)
    own = {name: weight * share / usual for name, weight in own.items()}
    return own | {"opinion": 1 - sum(own.values())}
