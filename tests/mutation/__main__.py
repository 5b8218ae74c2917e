"""python -m tests.mutation: see sample.py; spawned workers cannot import a package's __main__."""

import sys

from tests.mutation.sample import main

if __name__ == "__main__":
    sys.exit(main())
