"""Command lines of earlier versions: refused with the new spelling."""

from __future__ import annotations

import shlex

from ..errors import InputError


def refuse_old_spelling(arguments: list[str]) -> None:
    """Raise InputError with the new command for a command line that only earlier versions took."""
    verb, *words = [part for argument in arguments for part in argument.split("=", 1)] or [""]
    if verb == "train" and "--preset" in words:
        new = ["train", *("--model" if word == "--preset" else word for word in words)]
        raise InputError(f"the network is --model now: rtdenoise {shlex.join(new)}")
    if verb == "render" and {"--clips", "--preset"} & set(words):
        raise InputError(f"training clips have a command of their own now: rtdenoise {shlex.join(_as_clips(words))}")


def _as_clips(words: list[str]) -> list[str]:
    """The words of `render --clips` as words of `clips`; without `--preset train` the generator was the first one."""
    if "--preset" in words:
        at = words.index("--preset")
        words = words[:at] + words[at + 2 :]
    else:
        words = [*words, "--generator", "1"]
    return ["clips", *("--count" if word == "--clips" else word for word in words)]
