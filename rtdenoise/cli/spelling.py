"""Command lines of earlier versions: refused with the new spelling."""

from __future__ import annotations

import shlex

from ..errors import InputError

OF_CLIPS = ("--clips", "--preset")  # options with which `render` used to make training clips


def refuse_old_spelling(arguments: list[str]) -> None:
    """Raise InputError for a command line that an earlier version took and that is written differently now."""
    verb, options = arguments[:1], [argument.partition("=")[0] for argument in arguments[1:]]
    if verb == ["train"] and "--preset" in options:
        raise InputError(f"the network is --model now: rtdenoise {shlex.join(map(_as_model, arguments))}")
    if verb == ["render"] and (old := [name for name in OF_CLIPS if name in options]):
        raise InputError(f"render {old[0]}: training clips have a command of their own now: rtdenoise clips --out DIR "
                         "(see rtdenoise clips --help)")  # fmt: skip


def _as_model(argument: str) -> str:
    return f"--model{argument.removeprefix('--preset')}" if argument.startswith("--preset") else argument
