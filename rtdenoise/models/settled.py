"""Pictures of steps that wait for frames after theirs, once the picture of the frame after is there, too.

That one has seen nearly the same frames, but each counts in it for another place, and its network saw other noise. So
their mixture is closer to the truth than either, most where something was just uncovered: a fixed-lag smoother
(docs/notes/settled.md).
"""

from __future__ import annotations

from functools import reduce

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import DEPTH_TOLERANCE
from ..exposure import exposure
from ..frame import History
from ..ops import fetch, reproject, warp
from ..ops.kept import distance, nearer
from ..ops.relit import gain, relit_
from ..ops.settle import settle


def settled(after: History, following: History, ahead: Tensor | float = 0.0) -> Tensor:
    """The picture of a step, `[B, 3, H, W]`, with that of the step on the next frame of the shot in it. `after`,
    `following`: the histories that the two left, with `trusted`, and `motion_next` in the first; where light changes as
    a whole, both of frames that were divided by that. `ahead`: how far the camera has gone ahead between the two
    (`history.advance`).

    The next picture counts where it trusts what it knows of this one: the same surface, in light that has not changed,
    and nothing that comes before it (`approached`).
    """
    here = nearer(after.depth, ahead), after.normal
    there, motion = (following.depth, following.normal), after.motion_next
    alike, _ = reproject(following.trusted, motion, here, there)
    alike = alike * ~approached(here[0], there[0], motion)
    return mixed(after.radiance, after.noisy, following.radiance, motion, alike, after.trusted)


def approached(depth: Tensor, beside: Tensor, motion: Tensor) -> Tensor:
    """Pixels that something nearer has come to in a frame `beside` theirs in time, to which `motion` leads: it is among
    the 4 × 4 pixels that a picture is looked up in there (`ops.warp`), and not among 5 × 5 here, `[B, 1, H, W]` bool. A
    picture shows it in pixels of what is behind, too, and would leave its outline there."""
    here, there = _least(distance(depth), 2, 2), _least(distance(beside), 1, 2)
    return fetch(there, motion.floor()) < (1 - DEPTH_TOLERANCE) * here


def _least(image: Tensor, before: int, after: int) -> Tensor:
    """The least of each pixel, so many before and so many after it, across and down. Borders are repeated."""
    image = F.pad(image, (before, after, before, after), mode="replicate")
    for dim in (2, 3):  # torch's own pooling is not vectorised on a CPU
        size = image.shape[dim] - before - after
        image = reduce(torch.minimum, (image.narrow(dim, i, size) for i in range(1 + before + after)))
    return image


def mixed(image: Tensor, noisy: Tensor, beside: Tensor, motion: Tensor, alike: Tensor, trusted: Tensor) -> Tensor:
    """A picture with that of a frame `beside` it in time, to which `motion` leads; the rest as for `settle`. What a
    picture shows as it was rendered, as a sky without noise, stays. `beside` becomes as bright as the noisy frame."""
    alike = alike * (image != noisy).any(1, keepdim=True)
    following = warp(beside, motion, cubic=True)
    following = relit_(following, gain(following, noisy, alike > 0))
    return settle(image, following, noisy, alike, trusted, exposure(image))
