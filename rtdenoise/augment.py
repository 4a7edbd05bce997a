"""Random flips, quarter turns, time reversal, tints and channel permutations of a clip, motion vectors turned along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from .frame import Frame

_COLOURS = ("radiance", "albedo", "reference", "reference_half")
_LIGHT = ("radiance", "reference", "reference_half")
_MOTIONS = ("motion", "motion_next")
TINT = 0.5  # stops by which a colour channel of the light is brightened or darkened at most


def augment(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    """The same clip in a mirror, turned, backwards, lit in other colours or with its channels permuted: one draw for
    all its frames.

    Backwards, `motion` and `motion_next` change places; numbers and noise stay with their frames. World-space normals
    are left as they are: a mirrored picture is one of a mirrored world, in which they are as good as any.
    """
    flip_x, flip_y, transposed = rng.random(3) < 0.5
    order = torch.from_numpy(rng.permutation(3))
    backwards = rng.random() < 0.5
    tint = torch.from_numpy(2 ** rng.uniform(-TINT, TINT, 3)).float().reshape(1, 3, 1, 1)

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
        changes |= {k: changes[k] * tint for k in _LIGHT if k in changes}
        frame = replace(frame, **changes)
        return replace(frame, motion=frame.motion_next, motion_next=frame.motion) if backwards else frame

    turned_frames = [turned(frame) for frame in frames]
    return turned_frames[::-1] if backwards else turned_frames
