"""Fused ops for the CPU: C files beside this one, specialised by named constants and compiled on the user's machine.

Same names as in `rtdenoise.ops`, whose functions check the arguments and call these where they apply (`ops.path`).
Sums and weights are float32 whatever the logits are stored in; parity with the plain ops is `float32` of
tests/tolerances.py.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import c_float, c_int64, c_void_p

import torch
from torch import Tensor

from .compiler import library, pointer, problem
from .logits import LOGITS, constants
from .logits import apply_kernel as apply_kernel
from .logits import blend_history as blend_history
from .logits import pick as pick
from .logits import shares as shares
from .reproject import reproject as reproject
from .warp import fetch as fetch
from .warp import warp as warp

OF_LOGITS = ("apply_kernel", "blend_history", "pick", "shares")  # whose last argument they are


def prepare() -> None:
    """Compile the smallest file. Raises OSError where that is not possible here."""
    library("pyramid", POOL=0)


def unsupported(op: str, *tensors: Tensor) -> str | None:
    """Why `op` cannot take these arguments, or None."""
    image = tensors[0]
    floats, logits = (tensors[:-1], tensors[-1:]) if op in OF_LOGITS else (tensors, ())
    if any(t.dtype != torch.float32 for t in floats) or any(t.dtype not in LOGITS for t in logits):
        return f"for float32 images, not {', '.join(str(t.dtype).removeprefix('torch.') for t in tensors)}"
    if torch.is_grad_enabled() and any(t.requires_grad for t in _constant(op, tensors)):
        return "it has no gradient"
    if image.shape[1] > 8:
        return f"for at most 8 channels, not {image.shape[1]}"
    if image.numel() == 0 or image.shape[2] * image.shape[3] >= 2**31:
        return f"not for images of {tuple(image.shape)}"
    if op in ("apply_kernel", "blend_history", "pick"):
        return problem("pick" if op == "pick" else "apply_kernel", **constants(image, *logits))
    return None


def _constant(op: str, tensors: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """Those of the arguments that the fused op has no gradient in."""
    if op == "apply_kernel":
        return ()
    if op == "warp":
        return tensors[1:]
    return tensors[-5:] if op == "reproject" else tensors  # motion and geometry come last


def history_motion(motion: Tensor, next_before: Tensor, threshold: float) -> tuple[Tensor, Tensor, Tensor]:
    motion, next_before = motion.contiguous(), next_before.contiguous()
    B, _, H, W = motion.shape
    out, (seen, uncovered) = torch.empty_like(motion), torch.empty(2, B, 1, H, W, dtype=torch.bool)
    pointers = map(pointer, (motion, next_before, out, seen, uncovered))
    library("history_motion").history_motion(*pointers, B, H, W, c_float(threshold), torch.get_num_threads())
    return out, seen, uncovered


def downsample(image: Tensor, pool: str) -> Tensor:
    image = image.contiguous()
    B, C, H, W = image.shape
    out = image.new_empty(B, C, (H + 1) // 2, (W + 1) // 2)
    _pyramid(pool).downsample(pointer(image), pointer(out), B * C, H, W, torch.get_num_threads())
    return out


def compose(fine: Tensor, coarse: Tensor, alpha: Tensor, pool: str) -> Tensor:
    tensors = [t.contiguous() for t in (fine, coarse, alpha)]
    change, out = torch.empty_like(tensors[1]), torch.empty_like(tensors[0])
    _pyramid(pool).compose(*map(pointer, (*tensors, change, out)), *fine.shape, torch.get_num_threads())
    return out


def features(light: Sequence[Tensor], guides: Sequence[Tensor], scale: Tensor, dtype: torch.dtype) -> Tensor:
    """Channels last."""
    layers = [layer.contiguous() for layer in (*light, *guides)]
    B, _, H, W = layers[0].shape
    channels, lit = (sum(layer.shape[1] for layer in group) for group in (layers, light))
    out = torch.empty(B, channels, H, W, dtype=dtype, memory_format=torch.channels_last)
    run = library("features", C=channels, LIGHT=lit, HALF=int(dtype == torch.bfloat16)).features
    for b in range(B):
        planes = (c_void_p * channels)(*(plane.data_ptr() for layer in layers for plane in layer[b]))
        run(planes, c_float(scale[b].item()), pointer(out[b]), c_int64(H * W), torch.get_num_threads())
    return out


def demodulate(radiance: Tensor, albedo: Tensor, depth: Tensor) -> Tensor:
    out = torch.empty_like(radiance, memory_format=torch.contiguous_format)
    _each_pixel("demodulate", [radiance, albedo, depth], [out])
    return out


def modulate(irradiance: Tensor, *textures: Tensor) -> Tensor:
    """`textures` is albedo, mean_albedo, sharp and depth."""
    out = torch.empty_like(irradiance, memory_format=torch.contiguous_format)
    _each_pixel("modulate", [irradiance, *textures], [out])
    return out


def accumulate(new: Tensor, mean: Tensor, length: Tensor, reset: Tensor, longest: float) -> tuple[Tensor, Tensor]:
    out = [torch.empty_like(t, memory_format=torch.contiguous_format) for t in (new, length)]
    _each_pixel("accumulate", [new, mean, length, reset], out, c_float(longest))
    return out[0], out[1]


def nearness(depth: Tensor, distance: Tensor) -> Tensor:
    depth, out = depth.contiguous(), torch.empty_like(depth, memory_format=torch.contiguous_format)
    run, size = library("pixels", C=1).nearness, c_int64(depth[0].numel())
    for b in range(len(depth)):
        run(pointer(depth[b]), c_float(distance[b].item()), pointer(out[b]), size, torch.get_num_threads())
    return out


def within(values: Tensor, low: float, high: float) -> bool:
    values = values.contiguous()
    run = library("pixels", C=1).within
    return bool(run(pointer(values), c_int64(values.numel()), c_float(low), c_float(high), torch.get_num_threads()))


def block_luminance(radiance: Tensor, block: int) -> tuple[Tensor, Tensor]:
    radiance = radiance.contiguous()
    B, _, H, W = radiance.shape
    means, maxima = radiance.new_empty(2, B, -(-H // block) * -(-W // block))
    run = library("blocks").block_luminance
    run(*map(pointer, (radiance, means, maxima)), B, H, W, block, torch.get_num_threads())
    return means, maxima


def _each_pixel(name: str, inputs: list[Tensor], outputs: list[Tensor], *constants: c_float) -> None:
    B, C, H, W = inputs[0].shape
    inputs = [t.contiguous() for t in inputs]
    run = getattr(library("pixels", C=C), name)
    run(*map(pointer, (*inputs, *outputs)), B, c_int64(H * W), *constants, torch.get_num_threads())


def _pyramid(pool: str) -> ctypes.CDLL:
    return library("pyramid", POOL=("mean", "max").index(pool))
