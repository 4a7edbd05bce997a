"""How far light has moved over its surfaces since the frame before, as a network that averages light asks for it."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..frame import Frame, History, Known
from ..shift import picture
from ..shift.light import light_shift


def shifted(frame: Frame, history: History | None, known: Known) -> Known:
    """`known` with how far light has moved over its surfaces in a sanitised frame, if it has and that is not known. In
    a first frame it is supposed to have moved as it will to the frame after."""
    if known.on_surfaces or known.shift is not None:
        return known
    if history is None and known.ahead:
        other = known.ahead[0]
        shift = light_shift(frame.radiance, other.radiance, frame.motion_next, frame.depth, other.depth)
        return replace(known, on_surfaces=True) if shift is None else replace(known, shift=-shift)
    if history is None or history.noisy is None:
        return known
    shift = shift_of(frame, history.noisy, history.depth, history.shifts[:1])
    return replace(known, on_surfaces=True) if shift is None else replace(known, shift=shift, still=False)


def shift_of(frame: Frame, noisy_before: Tensor, depth_before: Tensor, told: tuple[Tensor, ...]) -> Tensor | None:
    """`Known.shift` of a sanitised frame with motion: that of light without noise, elsewhere what the frame
    before `told`, the first of these `History.shifts`, if there is any."""
    shift = light_shift(frame.radiance, noisy_before, frame.motion, frame.depth, depth_before)
    other = picture.moved(told[0], frame.motion, frame.depth) if told else None
    if shift is None or other is None:
        return other if shift is None else shift
    return torch.where(shift.ne(0).any(1, keepdim=True), shift, other)


def followed(frame: Frame, history: History | None, after: History, most: int) -> History:
    """`after` a sanitised frame with how light has moved over its surfaces in the picture, for the next frames. `most`:
    of `History.shifts`."""
    if history is None:
        return after
    found, agreed = picture.find(after.radiance, frame.motion, frame.depth, history)
    return replace(after, found=found, shifts=(agreed, *history.shifts)[:most])
