"""Run one compute shader over buffers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .context import GpuArray
from .program import program

FILL_ROW = 32 * 1024  # words that a row of work groups of `frame/fill` fills
GROUP = (32, 4)  # invocations of a work group: the 32 or 64 lanes that run together read whole rows


def dispatch(
    name: str,  # of the shader
    buffers: Sequence[GpuArray],  # in the order of its bindings, all of one context
    invocations: tuple[int, ...],  # (x, y), (x, y, z): how many are needed
    uniforms: Mapping[str, int | float | tuple[int, ...]],
    group: tuple[int, ...] = GROUP,  # work group size in x, y; () where the shader does not have it as constants
    **constants: int,
) -> None:
    """Run the shader for at least `invocations`, whole work groups, and make what it writes visible to what follows."""
    ctx = buffers[0].buffer.ctx
    sizes = dict(zip(("GROUP_X", "GROUP_Y"), group, strict=False))
    compute = program(ctx, name, **constants, **sizes)
    for key, value in uniforms.items():
        compute[key] = value
    for binding, array in enumerate(buffers):
        array.buffer.bind_to_storage_buffer(binding)
    per_group = (*group, 1, 1, 1)
    counts = [-(-n // per_group[axis]) for axis, n in enumerate(invocations)]
    compute.run(*counts)
    ctx.memory_barrier()


def fill(array: GpuArray, word: int = 0) -> None:
    """Set every 32-bit word of an array."""
    count = array.buffer.size // 4
    extent = min(count, FILL_ROW), -(-count // FILL_ROW)
    dispatch("frame/fill", [array], extent, {"count": count, "value": word}, (GROUP[0],), ROW=FILL_ROW)
