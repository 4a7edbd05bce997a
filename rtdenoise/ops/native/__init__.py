"""Fused ops for the CPU: C files beside this one, specialised by named constants and compiled on the user's machine.

Same names as in `rtdenoise.ops`, whose functions check the arguments and call these where they apply (`ops.path`).
Sums and weights are float32 whatever the logits are stored in; parity with the plain ops is `float32` of
tests/tolerances.py.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from ctypes import byref, c_float, c_int64, c_void_p

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..layout import in_planes, strides, whole
from .compiler import library, problem

LOGITS = {torch.float32: 0, torch.bfloat16: 1, torch.float16: 2}  # LOGIT of logits.h
OF_LOGITS = ("apply_kernel", "blend_history", "shares")  # whose last argument they are


def prepare() -> None:
    """Compile the smallest file. Raises OSError where that is not possible here."""
    library("pyramid", POOL=0)


def unsupported(op: str, *tensors: Tensor) -> str | None:
    """Why `op` cannot take these arguments, or None. Only `apply_kernel` has gradients here."""
    image = tensors[0]
    floats, logits = (tensors[:-1], tensors[-1:]) if op in OF_LOGITS else (tensors, ())
    if any(t.dtype != torch.float32 for t in floats) or any(t.dtype not in LOGITS for t in logits):
        return f"for float32 images, not {', '.join(str(t.dtype).removeprefix('torch.') for t in tensors)}"
    if op != "apply_kernel" and torch.is_grad_enabled() and any(t.requires_grad for t in tensors):
        return "it has no gradient"
    if image.shape[1] > 8:
        return f"for at most 8 channels, not {image.shape[1]}"
    if image.numel() == 0 or image.shape[2] * image.shape[3] >= 2**31:
        return f"not for images of {tuple(image.shape)}"
    if op in ("apply_kernel", "blend_history"):
        return problem("apply_kernel", **_constants(image, *logits))
    return None


def apply_kernel(image: Tensor, logits: Tensor) -> Tensor:
    if torch.is_grad_enabled() and (image.requires_grad or logits.requires_grad):
        return _ApplyKernel.apply(image, logits)
    return _forward(image.contiguous(), _readable(logits), None)


class _ApplyKernel(torch.autograd.Function):
    """Keeps two values a pixel (maximum and 1/sum) instead of K² weights, and computes those again on the way back."""

    @staticmethod
    def forward(ctx, image: Tensor, logits: Tensor) -> Tensor:
        image, logits = image.contiguous(), _planes(logits)
        stats = image.new_empty(image.shape[0], 2, *image.shape[2:])
        out = _forward(image, logits, stats)
        ctx.save_for_backward(image, logits, out, stats)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
        image, logits, out, stats = ctx.saved_tensors
        grad, grad_image, grad_logits = grad.contiguous(), None, None
        kernels, sizes = _kernels(image, logits), _sizes(image, logits)
        if ctx.needs_input_grad[0]:
            grad_image = torch.empty_like(image)
            kernels.backward_image(*map(_pointer, (logits, stats, grad, grad_image)), *sizes)
        if ctx.needs_input_grad[1]:
            grad_logits = torch.zeros(logits.shape)
            kernels.backward_logits(*map(_pointer, (image, logits, out, stats, grad, grad_logits)), *sizes)
            grad_logits = grad_logits.to(logits.dtype)
        return grad_image, grad_logits


def blend_history(spatial: Tensor, past: Tensor, seen: Tensor, logits: Tensor, alpha: Tensor) -> Tensor:
    others = [t.contiguous() for t in (seen, spatial, alpha)]
    return _forward(past.contiguous(), _readable(logits), None, *others)


def _forward(image: Tensor, logits: Tensor, stats: Tensor | None, *blended: Tensor) -> Tensor:
    """`blended` is nothing, or seen, spatial and alpha."""
    out = torch.empty_like(image)
    (B, _, H, W), layout = image.shape, (c_int64 * 6)(*strides(logits))
    pointers = map(_pointer, (image, logits, out, stats, *(blended or (None, None, None))))
    _kernels(image, logits).forward(*pointers, B, H, W, byref(layout), torch.get_num_threads())
    return out


def _kernels(image: Tensor, logits: Tensor) -> ctypes.CDLL:
    return library("apply_kernel", **_constants(image, logits))


def _constants(image: Tensor, logits: Tensor) -> dict[str, int]:
    return {"K": math.isqrt(logits.shape[-3]), "C": image.shape[1], "LOGIT": LOGITS[logits.dtype]}


def _sizes(image: Tensor, logits: Tensor) -> tuple[object, ...]:
    B, _, H, W = image.shape
    return B, H, W, c_int64(logits.stride(0)), c_int64(logits.stride(1)), torch.get_num_threads()


def _planes(logits: Tensor) -> Tensor:
    """With every plane contiguous."""
    return logits if in_planes(logits) and strides(logits)[3] == logits.shape[3] else logits.contiguous()


def _readable(logits: Tensor) -> Tensor:
    """With neighbours along x or along k: planes, channels last and slices of their channels are taken as they are."""
    if in_planes(logits) or strides(logits)[1] == 1 or logits.shape[-3] == 1:
        return logits
    return (whole(logits) if logits.ndim == 6 else logits).contiguous()


def shares(logits: Tensor, size: tuple[int, int]) -> Tensor:
    logits, (B, _, _, N) = _readable(logits), logits.shape[:4]
    out, layout = torch.empty(B, N, *size), (c_int64 * 6)(*strides(logits))
    run = library("shares", N=N, LOGIT=LOGITS[logits.dtype]).shares
    run(_pointer(logits), _pointer(out), B, *size, byref(layout), torch.get_num_threads())
    return out


def warp(image: Tensor, motion: Tensor, seen: Tensor | None = None, otherwise: Tensor | None = None) -> Tensor:
    return _look_up("warp", image, motion, seen, otherwise)


def fetch(image: Tensor, motion: Tensor) -> Tensor:
    return _look_up("fetch", image, motion)


def _look_up(name: str, *tensors: Tensor | None) -> Tensor:
    """The first of the tensors is looked up."""
    tensors = [t if t is None else t.contiguous() for t in tensors]
    B, C, H, W = tensors[0].shape
    out = torch.empty_like(tensors[0])
    getattr(library("warp", C=C), name)(*map(_pointer, (*tensors, out)), B, H, W, torch.get_num_threads())
    return out


def reproject(
    stored: list[Tensor], motion: Tensor, *geometry: Tensor, tolerances: tuple[float, float], least: float
) -> tuple[Tensor, Tensor]:
    """`geometry` is depth, normal, depth and normal of the previous frame."""
    stored, tensors = ([t.contiguous() for t in group] for group in (stored, (motion, *geometry)))
    planes = [plane.data_ptr() for images in zip(*stored, strict=True) for image in images for plane in image]
    B, _, H, W = motion.shape
    C = len(planes) // B
    out, valid = torch.empty(B, C, H, W), torch.empty(B, 1, H, W, dtype=torch.bool)
    limits = map(c_float, (*tolerances, least))
    pointers = map(_pointer, (*tensors, out, valid))
    run = library("reproject", C=C).reproject
    run((c_void_p * (B * C))(*planes), *pointers, B, H, W, *limits, torch.get_num_threads())
    return out, valid


def history_motion(motion: Tensor, next_before: Tensor, threshold: float) -> tuple[Tensor, Tensor, Tensor]:
    motion, next_before = motion.contiguous(), next_before.contiguous()
    B, _, H, W = motion.shape
    out, (seen, uncovered) = torch.empty_like(motion), torch.empty(2, B, 1, H, W, dtype=torch.bool)
    pointers = map(_pointer, (motion, next_before, out, seen, uncovered))
    library("history_motion").history_motion(*pointers, B, H, W, c_float(threshold), torch.get_num_threads())
    return out, seen, uncovered


def downsample(image: Tensor, pool: str) -> Tensor:
    image = image.contiguous()
    B, C, H, W = image.shape
    out = image.new_empty(B, C, (H + 1) // 2, (W + 1) // 2)
    _pyramid(pool).downsample(_pointer(image), _pointer(out), B * C, H, W, torch.get_num_threads())
    return out


def compose(fine: Tensor, coarse: Tensor, alpha: Tensor, pool: str) -> Tensor:
    tensors = [t.contiguous() for t in (fine, coarse, alpha)]
    change, out = torch.empty_like(tensors[1]), torch.empty_like(tensors[0])
    _pyramid(pool).compose(*map(_pointer, (*tensors, change, out)), *fine.shape, torch.get_num_threads())
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
        run(planes, c_float(scale[b].item()), _pointer(out[b]), c_int64(H * W), torch.get_num_threads())
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
        run(_pointer(depth[b]), c_float(distance[b].item()), _pointer(out[b]), size, torch.get_num_threads())
    return out


def within(values: Tensor, low: float, high: float) -> bool:
    values = values.contiguous()
    run = library("pixels", C=1).within
    return bool(run(_pointer(values), c_int64(values.numel()), c_float(low), c_float(high), torch.get_num_threads()))


def block_luminance(radiance: Tensor, block: int) -> tuple[Tensor, Tensor]:
    radiance = radiance.contiguous()
    B, _, H, W = radiance.shape
    means, maxima = radiance.new_empty(2, B, -(-H // block) * -(-W // block))
    run = library("blocks").block_luminance
    run(*map(_pointer, (radiance, means, maxima)), B, H, W, block, torch.get_num_threads())
    return means, maxima


def _each_pixel(name: str, inputs: list[Tensor], outputs: list[Tensor], *constants: c_float) -> None:
    B, C, H, W = inputs[0].shape
    inputs = [t.contiguous() for t in inputs]
    run = getattr(library("pixels", C=C), name)
    run(*map(_pointer, (*inputs, *outputs)), B, c_int64(H * W), *constants, torch.get_num_threads())


def _pyramid(pool: str) -> ctypes.CDLL:
    return library("pyramid", POOL=("mean", "max").index(pool))


def _pointer(tensor: Tensor | None) -> c_void_p:
    return c_void_p(tensor.data_ptr() if tensor is not None else None)
