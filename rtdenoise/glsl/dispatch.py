"""Run one compute shader over named buffers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass

import moderngl

from ..constants import BRIGHTNESS_BLOCK
from .context import GpuArray
from .program import Program, program
from .source import expect_names

Value = int | float | tuple[int | float, ...]

FILL_ROW = 32 * 1024  # words that a row of work groups of `frame/fill` fills
_WATCHER = "rtdenoise_watcher"  # attribute of a context
GROUP = (32, 4)  # invocations of a work group: the 32 or 64 lanes that run together read whole rows
BLOCK_GROUP = (BRIGHTNESS_BLOCK, BRIGHTNESS_BLOCK)  # a work group for each block that brightness is measured in
SELECT_GROUP = (256,)  # of the one work group that finds a value of a given rank (`select.glsl`)


@dataclass(frozen=True)
class Dispatch:
    """One run of a shader."""

    program: Program
    groups: tuple[int, ...]  # work groups in x, y, z
    buffers: dict[str, GpuArray]  # in the order of their bindings
    parameters: dict[str, Value]


def dispatch(
    name: str,  # of the shader
    size: tuple[int, ...],  # (x, y) or (x, y, z): how many invocations are needed
    buffers: Mapping[str, GpuArray],  # all of one context
    parameters: Mapping[str, Value] | None = None,
    group: tuple[int, ...] = GROUP,  # work group size in x, y; () where the shader does not have it as constants
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
    per_group = (*group, 1, 1, 1)
    groups = tuple(-(-n // per_group[axis]) for axis, n in enumerate((*size, 1, 1)[:3]))
    ordered = {key: buffers[key] for key in shader.source.buffers}
    for binding, array in enumerate(ordered.values()):
        array.buffer.bind_to_storage_buffer(binding)
    with vars(ctx).get(_WATCHER, nullcontext)(Dispatch(shader, groups, ordered, values)):
        shader.compute.run(*groups)
        ctx.memory_barrier()


@contextmanager
def watching(ctx: moderngl.Context, watcher: Callable[[Dispatch], AbstractContextManager]) -> Iterator[None]:
    """Run every dispatch of the context inside `watcher(dispatch)`, while the block lasts."""
    vars(ctx)[_WATCHER] = watcher
    try:
        yield
    finally:
        del vars(ctx)[_WATCHER]


def fill(array: GpuArray, word: int = 0) -> None:
    """Set every 32-bit word of an array."""
    count = array.buffer.size // 4
    extent = min(count, FILL_ROW), -(-count // FILL_ROW)
    dispatch("frame/fill", extent, {"values": array}, {"count": count, "value": word}, (GROUP[0],), ROW=FILL_ROW)
