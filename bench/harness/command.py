"""The command line of a benchmark."""

from __future__ import annotations

import sys
from collections.abc import Callable

import tyro

from rtdenoise.errors import InputError
from rtdenoise.run.memory import keep_freed


def run(main: Callable[..., None], description: str | None) -> None:
    """Call `main` with the options that its parameters describe, with freed memory kept, as `denoise` does; bad input
    ends the program with one line and exit code 2."""
    keep_freed()
    try:
        tyro.cli(main, description=description, config=(tyro.conf.OmitArgPrefixes,))
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
