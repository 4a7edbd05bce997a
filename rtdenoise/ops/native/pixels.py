"""Ops in which every pixel stands alone: one pass over memory each."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import c_float, c_int64

import torch
from torch import Tensor

from ...constants import GLOSS
from .compiler import library, planes, pointer


def demodulate(radiance: Tensor, albedo: Tensor, depth: Tensor) -> Tensor:
    out = torch.empty_like(radiance, memory_format=torch.contiguous_format)
    _each_pixel("demodulate", [radiance, albedo, depth], [out])
    return out


def modulate(irradiance: Tensor, albedo: Tensor, mean_albedo: Tensor, sharp: Tensor, depth: Tensor) -> Tensor:
    out = torch.empty_like(irradiance, memory_format=torch.contiguous_format)
    _each_pixel("modulate", [irradiance, albedo, mean_albedo, sharp, depth], [out])
    return out


def accumulate(
    new: Sequence[Tensor], mean: Tensor, length: Tensor, reset: Tensor, max_length: float, same: float
) -> tuple[Tensor, Tensor]:
    new, inputs = [t.contiguous() for t in new], [t.contiguous() for t in (mean, length, reset)]
    out = [torch.empty_like(t) for t in inputs[:2]]
    B, C, H, W = mean.shape
    run, size = _library(C).accumulate, c_int64(H * W)
    numbers = c_float(max_length), c_float(same)
    run(planes(new), *map(pointer, (*inputs, *out)), B, size, *numbers, torch.get_num_threads())
    return out[0], out[1]


def joined(a: Tensor, n: Tensor, b: Tensor, m: Tensor) -> tuple[Tensor, Tensor]:
    out, total = (torch.empty_like(t, memory_format=torch.contiguous_format) for t in (a, n))
    _each_pixel("joined", [a, n, b, m], [out, total])
    return out, total


def nearness(depth: Tensor, distance: Tensor) -> Tensor:
    depth, out = depth.contiguous(), torch.empty_like(depth, memory_format=torch.contiguous_format)
    run, size = _library(1).nearness, c_int64(depth[0].numel())
    for b in range(len(depth)):
        run(pointer(depth[b]), c_float(distance[b].item()), pointer(out[b]), size, torch.get_num_threads())
    return out


def within(values: Tensor, low: float, high: float) -> bool:
    values = values.contiguous()
    size, limits = c_int64(values.numel()), (c_float(low), c_float(high))
    return bool(_library(1).within(pointer(values), size, *limits, torch.get_num_threads()))


def _each_pixel(name: str, inputs: list[Tensor], outputs: list[Tensor]) -> None:
    B, C, H, W = inputs[0].shape
    inputs = [t.contiguous() for t in inputs]
    run = getattr(_library(C), name)
    run(*map(pointer, (*inputs, *outputs)), B, c_int64(H * W), torch.get_num_threads())


def _library(channels: int) -> ctypes.CDLL:
    return library("pixels", C=channels, GLOSS=GLOSS)
