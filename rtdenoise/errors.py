"""The one exception that is for the user, not for the programmer, and what its messages share."""

from collections.abc import Iterable
from difflib import get_close_matches


class InputError(ValueError):
    """Something outside the program is wrong: a file, a layer, a size, an option, a missing driver.

    The message is one line that names the thing, what was found, what was expected and what to do. The command line
    prints it and exits with 2; library users catch it as a `ValueError`.
    """


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """ " (did you mean 'svgf'?)" where `known` holds a similar name, else "": for a message about an unknown name."""
    near = get_close_matches(name.lower(), list(known), n=1, cutoff=0.6)
    return f" (did you mean {near[0]!r}?)" if near else ""
