"""`python -m hil`, for machines where the console script is not on the path."""

from hil.cli import main

main()
