"""The commands, and how their options are read: each command is a dataclass whose docstrings are its help."""

from __future__ import annotations

import types
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Union, get_args

import tyro
from tyro.conf import UseAppendAction, subcommand
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from ..errors import InputError, did_you_mean
from .clean import Clean
from .clips import Clips
from .combine import Combine
from .demo import Demo
from .denoise import Denoise
from .estimates import Estimates
from .evaluate import Evaluate
from .export import Export
from .inspect import Inspect
from .render import Render
from .report import Report
from .train import Train
from .view import View

Command = (
    Annotated[Denoise, subcommand("denoise")]
    | Annotated[Combine, subcommand("combine")]
    | Annotated[Inspect, subcommand("inspect")]
    | Annotated[Render, subcommand("render")]
    | Annotated[Clips, subcommand("clips")]
    | Annotated[Clean, subcommand("clean")]
    | Annotated[Estimates, subcommand("estimates")]
    | Annotated[Train, subcommand("train")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[Report, subcommand("report")]
    | Annotated[View, subcommand("view")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Demo, subcommand("demo")]
)
VERBS = [get_args(command)[0].__name__.lower() for command in get_args(Command)]
ABOUT = "Real-time denoising of path-traced animations. `rtdenoise --version` prints the version."
PLACEHOLDERS = {str: "NAME", int: "N", float: "X", Path: "PATH"}  # in the help


def parse(arguments: list[str]) -> Any:
    """The command that these words ask for. Exits with 0 after --help, with 2 after an option that means nothing.

    Raises InputError for an unknown command, and for files that a shell has put for a glob.
    """
    verb = arguments[0] if arguments else "-"
    if not verb.startswith("-") and verb not in VERBS:
        raise InputError(f"no command {verb!r}{did_you_mean(verb, VERBS)}; expected one of {', '.join(VERBS)}")
    read = partial(tyro.cli, Command, args=arguments, prog="rtdenoise", description=ABOUT, registry=READERS)
    command, unknown = read(return_unknown_args=True)
    if frames := [word for word in unknown if word.lower().endswith(".exr") and Path(word).is_file()]:
        raise InputError(f"{frames[0]}: is one file more than {verb} takes: put the glob in quotes, or name the "
                         f"folder, {Path(frames[0]).parent}")  # fmt: skip
    return read() if unknown else command  # which names what is unknown, and what is near


READERS = ConstructorRegistry()


@READERS.primitive_rule
def _read_list(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """`tuple[T, ...]` as words; numbers also with commas between them."""
    item = get_args(info.type)[0] if info.type_origin is tuple else None
    if get_args(info.type)[1:] != (...,) or item not in PLACEHOLDERS or UseAppendAction in info.markers:
        return None

    def read(words: list[str]) -> tuple:
        parts = [part for word in words for part in word.split(",") if part] if item in (int, float) else words
        return tuple(item(part) for part in parts)

    return _spec("*", f"{PLACEHOLDERS[item]} ...", read, lambda value: isinstance(value, tuple), list)


@READERS.primitive_rule
def _read_optional(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """`T | None` as one word."""
    kinds = [kind for kind in get_args(info.type) if kind is not types.NoneType]
    if info.type_origin not in (Union, types.UnionType) or len(kinds) != 1 or kinds[0] not in PLACEHOLDERS:
        return None
    return _spec(
        1, PLACEHOLDERS[kinds[0]], lambda words: kinds[0](words[0]),
        lambda value: value is None or isinstance(value, kinds[0]), lambda value: [] if value is None else [value],
    )  # fmt: skip


def _spec(
    count: int | str, placeholder: str, read: Callable, fits: Callable, words: Callable[[Any], Sequence]
) -> PrimitiveConstructorSpec:
    shown = lambda value: [str(word) for word in words(value)] or ["none"]  # noqa: E731
    return PrimitiveConstructorSpec(count, placeholder, read, fits, shown)
