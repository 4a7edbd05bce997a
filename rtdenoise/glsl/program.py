"""Shaders as programs: compiled once per context and set of constants."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources.abc import Traversable

import moderngl

from .current import current
from .source import ShaderError, ShaderText, expand, locate


@dataclass(frozen=True)
class Program:
    """A compiled shader and the names of the buffers and parameters that it takes."""

    name: str
    compute: moderngl.ComputeShader
    source: ShaderText


def program(ctx: moderngl.Context, name: str, /, *, folder: Traversable | None = None, **constants: int) -> Program:
    """The compute shader `name`.comp.glsl specialised by `constants`: compiled on the first call, then the same object.

    `folder` replaces the project's `shaders`. Raises ShaderError as `expand`, and where the shader does not compile.
    """
    # The programs are kept in the context itself: they hold it, so a table elsewhere would keep both alive for ever.
    programs = vars(ctx).setdefault("rtdenoise_programs", {})
    key = (str(folder), name, tuple(sorted(constants.items())))
    if key not in programs:
        source = expand(name, folder=folder, **constants)
        try:
            with current(ctx):
                programs[key] = Program(name, ctx.compute_shader(source.text), source)
        except moderngl.Error as error:
            raise ShaderError(f"{name}.comp.glsl does not compile:\n{locate(str(error), source.origin)}") from None
    return programs[key]
