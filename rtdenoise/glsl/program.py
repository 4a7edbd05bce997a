"""Shaders from files: found, included, specialised by named constants, compiled once per context.

A shader declares the constants it needs, in itself or in what it includes; each becomes a `#define` behind `#version`:

    #pragma constants KERNEL CHANNELS
    #include "tensor.glsl"              // a file of shaders/include, taken once however often it is asked for

For an engine of one's own `expand` gives the text of a shader with everything in it, OpenGL or Vulkan (SPIR-V) alike:

    print(expand("ops/apply_kernel", KERNEL=5, CHANNELS=3, LOGITS_HALF=1, GROUP_X=32, GROUP_Y=4)[0])
"""

from __future__ import annotations

import re
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

import moderngl

_CONSTANTS = re.compile(r"^\s*#\s*pragma\s+constants\s+(.*)$")
_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"')
_LOCATION = re.compile(r"^((?:ERROR: |WARNING: )?)\d+[:(](\d+)\)?", re.MULTILINE)


class ShaderError(Exception):
    """A shader is not there, includes itself, is given constants that do not match, or does not compile."""


def program(
    ctx: moderngl.Context, name: str, /, *, folder: Traversable | None = None, **constants: int
) -> moderngl.ComputeShader:
    """The compute shader `name`.comp.glsl specialised by `constants`: compiled on the first call, then the same object.

    `folder` replaces the project's own `shaders`. Raises ShaderError.
    """
    # The programs lie in the context itself: they hold it, so a table outside would keep both alive for ever.
    programs = vars(ctx).setdefault("rtdenoise_programs", {})
    key = (str(folder), name, tuple(sorted(constants.items())))
    if key not in programs:
        source, origin = expand(name, folder=folder, **constants)
        try:
            programs[key] = ctx.compute_shader(source)
        except moderngl.Error as error:
            raise ShaderError(f"{name}.comp.glsl does not compile:\n{locate(str(error), origin)}") from None
    return programs[key]


def expand(name: str, /, *, folder: Traversable | None = None, **constants: int) -> tuple[str, list[str]]:
    """The text the compiler gets, and for each of its lines where it comes from, as "file:line".

    Raises ShaderError for a file that is missing, an include loop, and constants other than the declared ones.
    """
    folder = folder or shaders()
    lines: list[str] = []
    origin: list[str] = []
    declared: set[str] = set()
    done: set[str] = set()

    def add(file: str, stack: tuple[str, ...]) -> None:
        if file in stack:
            raise ShaderError(f"include loop: {' → '.join((*stack, file))}")
        if file in done:
            return
        done.add(file)
        for number, line in enumerate(_read(folder, file, stack).splitlines(), start=1):
            if match := _INCLUDE.match(line):
                add(f"include/{match[1]}", (*stack, file))
                continue
            if match := _CONSTANTS.match(line):
                declared.update(match[1].split())
                continue
            lines.append(line)
            origin.append(f"{file}:{number}")

    root = f"{name}.comp.glsl"
    add(root, ())
    if missing := declared - constants.keys():
        raise ShaderError(f"{root}: missing constants {', '.join(sorted(missing))}")
    if unknown := constants.keys() - declared:
        known = ", ".join(sorted(declared))
        raise ShaderError(f"{root}: unknown constants {', '.join(sorted(unknown))}; it takes {known}")
    if not lines or not lines[0].startswith("#version"):
        raise ShaderError(f"{root}:1: expected #version on the first line")
    defines = [f"#define {key} {int(value)}" for key, value in constants.items()]
    lines[1:1] = defines
    origin[1:1] = [f"{root}:constants"] * len(defines)
    return "\n".join(lines) + "\n", origin


def shaders() -> Traversable:
    """The folder of shaders: inside the installed package, or beside it in a source tree."""
    packaged = resources.files("rtdenoise") / "shaders"
    return packaged if packaged.is_dir() else Path(__file__).parents[2] / "shaders"


def locate(log: str, origin: list[str]) -> str:
    """The compiler's log with "file:line" for its line numbers.

    Not with `#line`: Mesa forgets the number of the file that `#line` sets in some of its messages. Understands
    `0:12(3): …` (Mesa), `0(12) : …` (NVIDIA) and `ERROR: 0:12: …` (AMD, Intel, glslang).
    """
    return _LOCATION.sub(lambda match: f"{match[1]}{origin[min(int(match[2]), len(origin)) - 1]}", log)


def _read(folder: Traversable, file: str, stack: tuple[str, ...]) -> str:
    try:
        return folder.joinpath(file).read_text(encoding="utf-8")
    except FileNotFoundError:
        asked = f", included by {stack[-1]}" if stack else ""
        raise ShaderError(f"no shader file {file} in {folder}{asked}") from None
