"""Random flips, quarter turns and channel permutations of a clip, with its motion vectors turned along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from .frame import Frame

_COLOURS = ("radiance", "albedo", "reference", "reference_half")
_MOTIONS = ("motion", "motion_next")


def augment(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    """The same clip seen in a mirror, turned, or with its colour channels permuted: one draw for all its frames.

    World-space normals are left as they are: a mirrored picture is one of a mirrored world, in which they are as good
    as any.
    """
    flip_x, flip_y, transposed = rng.random(3) < 0.5
    order = torch.from_numpy(rng.permutation(3))

    def spatial(tensor: Tensor) -> Tensor:
        tensor = tensor.transpose(2, 3) if transposed else tensor
        axes = [axis for axis, flipped in ((3, flip_x), (2, flip_y)) if flipped]
        return tensor.flip(axes) if axes else tensor

    sign = torch.tensor([-1.0 if flip_x else 1.0, -1.0 if flip_y else 1.0]).reshape(1, 2, 1, 1)

    def turned(frame: Frame) -> Frame:
        frame = frame.map(spatial)
        changes = {k: t[:, order] for k in _COLOURS if (t := getattr(frame, k)) is not None}
        changes |= {
            k: (t.flip(1) if transposed else t) * sign for k in _MOTIONS if (t := getattr(frame, k)) is not None
        }
        return replace(frame, **changes)

    return [turned(frame) for frame in frames]
