"""The one exception that is for the user, not for the programmer, and the parts that its messages share."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

INSTALL_TORCH = "type: pip install 'rtdenoise[torch]'"  # where rtdenoise is installed no index needs to have it
MAX_MESSAGE = 2000  # characters


class InputError(ValueError):
    """Something outside the program is wrong: a file, a layer, a size, an option, a missing driver.

    The message is one line that names the thing, the value found, the value expected and the remedy. The command line
    prints it and exits with 2; library users catch it as a `ValueError`. Control characters, as in file names, are
    escaped, and long messages, as when a damaged file is quoted, lose their middle.
    """

    def __init__(self, message: str) -> None:
        line = printable(message)
        if len(line) > MAX_MESSAGE:
            line = f"{line[: MAX_MESSAGE // 2]} … {line[-MAX_MESSAGE // 3 :]}"
        super().__init__(line)


class NotFused(RuntimeError):
    """RTDENOISE_OPS=fused, or `ops.use`, asks for a fused op where only the plain one can run."""


class NotCompiled(OSError):
    """A fused op cannot be compiled or loaded here; the plain one takes its place."""


def printable(text: str) -> str:
    """The text with `\\n`, `\\x1b` and so on for characters that would not show, or would steer a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """ " (did you mean 'svgf'?)" where `known` holds a similar name, else "": for a message about an unknown name."""
    near = get_close_matches(name.lower(), list(known), n=1, cutoff=0.6)
    return f" (did you mean {near[0]!r}?)" if near else ""
