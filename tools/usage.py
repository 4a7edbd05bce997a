"""How scripts of this folder are called: `call(main, __doc__)`."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable

from rtdenoise.errors import InputError


def call(main: Callable[..., None], document: str) -> None:
    """Run `main` with the words of the command line. With --help, or a number of words that it does not take, print the
    script's document instead; bad input ends the program with one line."""
    words = sys.argv[1:]
    if {"-h", "--help"} & {*words}:
        print(document)
        return
    try:
        inspect.signature(main).bind(*words)
    except TypeError:
        sys.exit(document)
    try:
        main(*words)
    except (InputError, ValueError) as error:
        sys.exit(f"{sys.argv[0]}: {error}")
