"""`python -m rtdenoise`."""

from .cli import main

main()
