"""`python -m sim_plant.native`: compile the kernel for this environment; `make setup` does."""

import sys

from sim_plant.native.library import BuildError, build


def main() -> None:
    """Exit status 1: it could not be built; stages are then computed in Python, with the same bits."""
    try:
        print(f"the stage's native kernel: {build()}")
    except BuildError as error:
        sys.exit(f"no native kernel: {error}. Stages are computed in Python, slower, with the same result")


if __name__ == "__main__":
    main()
