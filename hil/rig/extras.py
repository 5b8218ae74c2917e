"""How to install what a part of hil needs besides: an extra of pyproject.toml."""

import shlex
import sys


def install_command(extra: str) -> str:
    """The command, for the Python that runs here: another one's pip would install it where hil is not."""
    return f"{shlex.quote(sys.executable)} -m pip install 'hil[{extra}]'"
