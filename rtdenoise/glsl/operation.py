"""Run the shader of an operation on numpy arrays or on arrays in GPU memory, and check shapes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .context import GpuArray, default_context
from .current import current
from .dispatch import GROUP, dispatch

Array = np.ndarray | GpuArray


def run(
    name: str,
    inputs: dict[str, Array],
    shape: tuple[int, ...],
    size: tuple[int, int],
    out: GpuArray | None,
    group: tuple[int, int] = GROUP,
    **constants: int,
) -> Array:
    """`run_all` of a shader with one result."""
    return run_all(name, inputs, {"result": shape}, size, [out], {}, group, **constants)[0]


def run_all(
    name: str,  # of the shader
    inputs: dict[str, Array],  # by the names of its buffers
    shapes: dict[str, tuple[int, ...]],  # [B, C, H, W] of the results, likewise
    size: tuple[int, int],  # (H, W) of the finer grid
    outs: Sequence[GpuArray | None],
    parameters: dict,
    group: tuple[int, int] = GROUP,
    **constants: int,
) -> list[Array]:
    """One dispatch, an invocation for every pixel of the results. Raises ValueError for a mixture of numpy arrays and
    GpuArrays, and for arrays of another dtype than the shader's or an `out` that does not fit."""
    on_gpu = _on_gpu(name, inputs, outs)
    if not any(math.prod(shape) for shape in shapes.values()):  # OpenGL has no empty buffers
        return [np.zeros(shape, np.float32) for shape in shapes.values()]
    ctx = next(iter(inputs.values())).buffer.ctx if on_gpu else default_context()
    dtypes = {key: np.float16 if key == "logits" and constants["LOGITS_HALF"] else np.float32 for key in inputs}
    arrays = inputs if on_gpu else {key: GpuArray.upload(ctx, inputs[key], dtypes[key]) for key in inputs}
    results = {key: out or GpuArray.empty(ctx, shape) for out, (key, shape) in zip(outs, shapes.items(), strict=True)}
    for key, result in results.items():
        expect("out", result, shapes[key])
        if any(array.buffer is result.buffer for array in arrays.values()):
            raise ValueError(f"{name}: `out` must be none of the inputs")
    for key, array in (arrays | results).items():
        if array.dtype != (expected := np.dtype(dtypes.get(key, np.float32))):
            raise ValueError(f"{name}: expected {expected}, got {array.dtype}")

    B, _, H, W = next(iter(shapes.values()))
    with current(ctx):
        dispatch(f"ops/{name}", (W, H, B), arrays | results, {"size": size[::-1], **parameters}, group, **constants)
    return [result if on_gpu else result.read() for result in results.values()]


def shape_of(name: str, array: Array) -> tuple[int, int, int, int]:
    """(B, C, H, W). Raises ValueError for another number of dimensions."""
    if len(array.shape) != 4:
        raise ValueError(f"expected {name} [B, C, H, W], got {tuple(array.shape)}")
    return tuple(array.shape)


def expect(name: str, array: Array, shape: tuple[int, ...]) -> None:
    """Raise ValueError where the array has another shape."""
    if tuple(array.shape) != tuple(shape):
        raise ValueError(f"expected {name} {tuple(shape)}, got {tuple(array.shape)}")


def _on_gpu(name: str, inputs: dict[str, Array], outs: Sequence[GpuArray | None]) -> bool:
    """Whether the inputs are GpuArrays; all or none of them must be."""
    kinds = {isinstance(array, GpuArray) for array in inputs.values()}
    if len(kinds) > 1:
        raise ValueError(f"{name}: expected either numpy arrays or GpuArrays, got both")
    if kinds == {False} and any(out is not None for out in outs):
        raise ValueError(f"{name}: `out` goes with GpuArrays only")
    return kinds == {True}
