"""`evened` and `held_and_tells`: the greatest value of each cell, then the pixels."""

from __future__ import annotations

from ctypes import CDLL

import torch
from torch import Tensor

from ...constants import AROUND_CELL, MIX_SEEN_ONCE
from .compiler import library, pointer


def evened(light: Tensor, count: Tensor, image: Tensor, trust: Tensor) -> Tensor:
    light, count, image, trust = (x.contiguous() for x in (light, count, image, trust))
    most, out = _greatest(count), torch.empty_like(light)
    _code().evened(*map(pointer, (light, count, image, trust, most, out)), *_size(light))
    return out


def held_and_tells(held: Tensor) -> tuple[Tensor, Tensor]:
    held = held.contiguous()
    most, (numbers, tells) = _greatest(held), _empty(2, *held.shape).unbind()
    flags = int(held.dtype is torch.bool)
    _code().held_and_tells(pointer(held), flags, *map(pointer, (most, numbers, tells)), *_size(held))
    return numbers, tells


def _greatest(x: Tensor) -> Tensor:
    B, _, H, W = x.shape
    most = _empty(B, -(-H // AROUND_CELL), -(-W // AROUND_CELL))
    _code().greatest(pointer(x), int(x.dtype is torch.bool), pointer(most), *_size(x))
    return most


def _empty(*shape: int) -> Tensor:
    return torch.empty(shape, dtype=torch.float32, device="cpu")


def _size(x: Tensor) -> tuple[int, int, int, int]:
    B, _, H, W = x.shape
    return B, H, W, torch.get_num_threads()


def _code() -> CDLL:
    return library("evened", CELL=AROUND_CELL, SEEN_ONCE=MIX_SEEN_ONCE)
