"""`python -m rtdenoise`."""

from .cli.main import main

main()
