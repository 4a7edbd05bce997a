"""The text of a shader: found, included, specialised by named constants.

A shader declares by name all that it takes, in itself or in the files that it includes:

    #include "tensor.glsl"                  // a file of shaders/include, taken once however often it is asked for
    #pragma constants KERNEL CHANNELS       // become #defines; those of `shared.SHARED` are known, the others are given
    #pragma parameters ivec2 size           // set for every dispatch: uniforms, or in Vulkan push constants
    #pragma reads float image, vec4 guide   // storage buffers: float image[], vec4 guide[]; also `writes`, `changes`

For an engine of one's own, `expand` gives the whole text, which OpenGL and, as SPIR-V, Vulkan compile:

    print(expand("ops/apply_kernel", KERNEL=5, CHANNELS=3, LOGITS_HALF=1, GROUP_X=32, GROUP_Y=4).text)
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from .shared import SHARED

Constant = int | float | tuple[float, ...]

MAX_BUFFERS = 8  # of one shader, which is what OpenGL 4.3 guarantees
_QUALIFIERS = {"reads": "readonly ", "writes": "writeonly ", "changes": ""}
_PRAGMA = re.compile(r"^\s*#\s*pragma\s+(constants|parameters|reads|writes|changes)\b([^/]*)")
_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"')
_LOCATION = re.compile(r"^((?:ERROR: |WARNING: )?)\d+[:(](\d+)\)?", re.MULTILINE)


class ShaderError(Exception):
    """A shader is missing, includes itself, is given names that it does not declare, or does not compile."""


@dataclass(frozen=True)
class ShaderText:
    """The text that the compiler gets, and the names that it takes."""

    text: str
    origin: list[str]  # for each line "file:line" where it comes from
    buffers: tuple[str, ...]  # in the order of their bindings, 0, 1, …
    parameters: tuple[str, ...]
    access: tuple[str, ...]  # of each buffer: "reads", "writes" or "changes"
    types: tuple[str, ...]  # of each parameter: "ivec2"
    constants: dict[str, Constant]  # all of them, also those of `shared.SHARED`


def expand(name: str, /, *, folder: Traversable | None = None, **constants: int | float) -> ShaderText:
    """The shader `name`.comp.glsl with its includes, specialised by `constants`; `folder` replaces `shaders()`.

    Raises ShaderError for a file that is missing, an include loop, a malformed declaration, too many buffers, and
    constants other than the declared ones.
    """
    file = f"{name}.comp.glsl"
    found = _Declarations(folder or shaders())
    found.add(file)
    if not found.lines or not found.lines[0].startswith("#version"):
        raise ShaderError(f"{file}:1: expected #version on the first line")
    if len(found.buffers) > MAX_BUFFERS:
        raise ShaderError(f"{file}: {len(found.buffers)} buffers, expected at most {MAX_BUFFERS}")
    values = {key: SHARED[key] for key in found.constants & SHARED.keys()} | constants
    expect_names(file, "constants", values, found.constants)
    head = [f"#define {key} {_literal(value)}" for key, value in values.items()] + found.parameter_lines()
    text = [found.lines[0], *head, *found.lines[1:]]
    origin = [found.origin[0], *[f"{file}:constants"] * len(head), *found.origin[1:]]
    return ShaderText(
        "\n".join(text) + "\n", origin, tuple(found.buffers), tuple(found.parameters), tuple(found.access.values()),
        tuple(found.parameters.values()), values,
    )  # fmt: skip


def expect_names(shader: str, kind: str, given: Iterable[str], declared: Iterable[str]) -> None:
    """Raise ShaderError where the names given are not the names declared."""
    given, declared = set(given), set(declared)
    if missing := declared - given:
        raise ShaderError(f"{shader}: missing {kind} {', '.join(sorted(missing))}")
    if unknown := given - declared:
        takes = f"it takes {', '.join(sorted(declared))}" if declared else "it takes none"
        raise ShaderError(f"{shader}: unknown {kind} {', '.join(sorted(unknown))}; {takes}")


def shaders() -> Traversable:
    """The folder of shaders: inside the installed package, or beside it in a source tree."""
    packaged = resources.files("rtdenoise") / "shaders"
    return packaged if packaged.is_dir() else Path(__file__).parents[2] / "shaders"


def locate(log: str, origin: list[str]) -> str:
    """The compiler's log with "file:line" for its line numbers.

    `#line` will not do: Mesa loses the file number that it sets in some messages. Understands `0:12(3): …` (Mesa),
    `0(12) : …` (NVIDIA) and `ERROR: 0:12: …` (AMD, Intel, glslang).
    """
    return _LOCATION.sub(lambda match: f"{match[1]}{origin[min(int(match[2]), len(origin)) - 1]}", log)


@dataclass
class _Declarations:
    """The lines of a shader and of its includes, and the names that they declare."""

    folder: Traversable
    lines: list[str] = field(default_factory=list)
    origin: list[str] = field(default_factory=list)
    constants: set[str] = field(default_factory=set)
    parameters: dict[str, str] = field(default_factory=dict)  # name -> type
    buffers: dict[str, int] = field(default_factory=dict)  # name -> binding
    access: dict[str, str] = field(default_factory=dict)  # name of a buffer -> "reads", "writes" or "changes"
    files: set[str] = field(default_factory=set)

    def add(self, file: str, stack: tuple[str, ...] = ()) -> None:
        """Append a file, included by those of `stack`, unless it is there already."""
        if file in stack:
            raise ShaderError(f"include loop: {' → '.join((*stack, file))}")
        if file in self.files:
            return
        self.files.add(file)
        for number, line in enumerate(_read(self.folder, file, stack).splitlines(), start=1):
            if match := _INCLUDE.match(line):
                self.add(f"include/{match[1]}", (*stack, file))
                continue
            if match := _PRAGMA.match(line):
                line = self._declare(match[1], match[2], f"{file}:{number}")
            self.lines.append(line)
            self.origin.append(f"{file}:{number}")

    def parameter_lines(self) -> list[str]:
        """The declaration of the parameters."""
        if not self.parameters:
            return []
        members = [f"{kind} {name};" for name, kind in self.parameters.items()]
        block = f"layout(push_constant) uniform Parameters {{ {' '.join(members)} }};"
        return ["#ifdef VULKAN", block, "#else", *(f"uniform {member}" for member in members), "#endif"]

    def _declare(self, pragma: str, names: str, where: str) -> str:
        """Note the names that a pragma declares, and return the line that takes its place."""
        if pragma == "constants":
            self.constants.update(names.split())
            return ""
        try:
            pairs = [(kind, name) for kind, name in (pair.split() for pair in names.split(","))]
        except ValueError:
            raise ShaderError(f"{where}: expected `#pragma {pragma} TYPE NAME, TYPE NAME …`") from None
        if pragma == "parameters":
            for kind, name in pairs:
                if self.parameters.setdefault(name, kind) != kind:
                    raise ShaderError(f"{where}: parameter {name} is {self.parameters[name]} elsewhere, here {kind}")
            return ""
        return " ".join(self._buffer(pragma, *pair) for pair in pairs)

    def _buffer(self, pragma: str, kind: str, name: str) -> str:
        """A buffer that is declared in two branches of an #if has one binding."""
        binding = self.buffers.setdefault(name, len(self.buffers))
        self.access[name] = pragma
        block = "".join(word.capitalize() for word in name.split("_"))
        layout = f"layout(std430, binding = {binding}) {_QUALIFIERS[pragma]}restrict"
        return f"{layout} buffer {block} {{ {kind} {name}[]; }};"


def _literal(value: Constant) -> str:
    """A constant as GLSL spells it."""
    if isinstance(value, tuple):
        return f"vec{len(value)}({', '.join(map(repr, value))})"
    return repr(value) if isinstance(value, float) else str(int(value))


def _read(folder: Traversable, file: str, stack: tuple[str, ...]) -> str:
    try:
        return folder.joinpath(file).read_text(encoding="utf-8")
    except FileNotFoundError:
        asked = f", included by {stack[-1]}" if stack else ""
        raise ShaderError(f"no shader file {file} in {folder}{asked}") from None
