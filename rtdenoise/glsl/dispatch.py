"""Run one compute shader over named buffers."""

from __future__ import annotations

from collections.abc import Mapping

from .context import GpuArray
from .program import program
from .source import expect_names

FILL_ROW = 32 * 1024  # words that a row of work groups of `frame/fill` fills
GROUP = (32, 4)  # invocations of a work group: the 32 or 64 lanes that run together read whole rows


def dispatch(
    name: str,  # of the shader
    size: tuple[int, ...],  # (x, y) or (x, y, z): how many invocations are needed
    buffers: Mapping[str, GpuArray],  # all of one context
    parameters: Mapping[str, int | float | tuple[int | float, ...]] | None = None,
    group: tuple[int, ...] = GROUP,  # work group size in x, y; () if the shader fixes its own
    **constants: int,
) -> None:
    """Run the shader for at least `size` invocations, in whole work groups; the next dispatch sees its results.

    The parameter `size` is (x, y) unless `parameters` says otherwise. Raises ShaderError where the names of buffers,
    parameters or constants are not exactly those that the shader declares.
    """
    ctx = next(iter(buffers.values())).buffer.ctx
    shader = program(ctx, name, **constants, **dict(zip(("GROUP_X", "GROUP_Y"), group, strict=False)))
    values = dict(parameters or {})
    if "size" in shader.source.parameters:
        values.setdefault("size", size[:2])
    expect_names(f"{name}.comp.glsl", "parameters", values, shader.source.parameters)
    expect_names(f"{name}.comp.glsl", "buffers", buffers, shader.source.buffers)
    for key, value in values.items():
        if key in shader.compute:  # drivers drop parameters that this specialisation does not read
            shader.compute[key] = value
    for binding, key in enumerate(shader.source.buffers):
        buffers[key].buffer.bind_to_storage_buffer(binding)
    per_group = (*group, 1, 1, 1)
    shader.compute.run(*(-(-n // per_group[axis]) for axis, n in enumerate(size)))
    ctx.memory_barrier()


def fill(array: GpuArray, word: int = 0) -> None:
    """Set every 32-bit word of an array."""
    count = array.buffer.size // 4
    extent = min(count, FILL_ROW), -(-count // FILL_ROW)
    dispatch("frame/fill", extent, {"values": array}, {"count": count, "value": word}, (GROUP[0],), ROW=FILL_ROW)
