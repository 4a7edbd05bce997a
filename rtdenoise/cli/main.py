"""The entry point `rtdenoise`: it runs a command and turns every error that a user can cause into one line.

This module imports almost nothing, so that Ctrl-C is caught while the rest is being imported.
"""

from __future__ import annotations

import os
import sys

from ..errors import InputError
from .failures import line

INTERRUPTED = "interrupted; run the same command again to go on"
ADVICE = "; use smaller frames, a smaller --batch or fewer --workers, or close other programs"
MIN_ADDRESS_SPACE = 700e6  # bytes; with less, libraries abort while they are loaded


def main(arguments: list[str] | None = None) -> None:
    """Run the command line (`sys.argv` if `arguments` is None).

    Exit codes: 0 done; 2 wrong input or options, one line on stderr; 130 interrupted; 141 the reader of stdout is gone.
    """
    try:
        try:
            _run(sys.argv[1:] if arguments is None else arguments)
        finally:
            if sys.stdout:
                sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the interpreter flushes once more as it exits
        sys.exit(141)
    except KeyboardInterrupt:
        _stop(130, INTERRUPTED)
    except Exception as error:
        if (said := line(error, ADVICE)) is not None:
            _stop(2, said)
        # Compiled modules turn Ctrl-C during their import into an ImportError.
        if isinstance(error, ImportError) and isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            _stop(130, INTERRUPTED)
        raise


def _run(arguments: list[str]) -> None:
    from ..run.threads import set_defaults
    from .console import accept_every_character

    accept_every_character(sys.stdout, sys.stderr)
    if arguments in (["--version"], ["-V"]):
        from .. import __version__

        print(f"rtdenoise {__version__}")
        return
    _refuse_low_limit()
    set_defaults()

    from .commands import parse

    parse(arguments).run()


def _refuse_low_limit() -> None:
    """Raise InputError where the system grants this process too little memory to start (ulimit -v)."""
    try:
        from resource import RLIMIT_AS, getrlimit
    except ImportError:  # Windows
        return
    limit = getrlimit(RLIMIT_AS)[0]
    if 0 <= limit < MIN_ADDRESS_SPACE:
        raise InputError(f"out of memory: this process is limited to {limit / 1e6:.0f} MB (ulimit -v), it needs at "
                         f"least {MIN_ADDRESS_SPACE / 1e6:.0f} MB")  # fmt: skip


def _stop(code: int, message: str) -> None:
    print(f"rtdenoise: {message}", file=sys.stderr)
    sys.exit(code)
