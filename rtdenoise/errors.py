"""The one exception that is for the user, not for the programmer."""


class InputError(ValueError):
    """Something outside the program is wrong: a file, a layer, a size, an option, a missing driver.

    The message is one line that names the thing, what was found, what was expected and what to do. The command line
    prints it and exits with 2; library users catch it as a `ValueError`.
    """
