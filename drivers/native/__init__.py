"""What a tick does with its frames once more, in C (path.c): the same bytes in a fraction of the instructions.

Only the compiled build has it (deploy/compiled/extensions.py). In a checkout the twins in Python run. They say what
each function means, and are what tests and mutants look at: recvmmsg.py and receive_block.py in drivers/bus,
stage/stage_fd.py and cia402/host.py in drivers/families, hil/live/pacing.py, hil/cycle/record_builder.py.
"""

import importlib
import os
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeVar

OFF = "HIL_NATIVE"  # in the environment, set to 0: Python all the same


_Tuple = TypeVar("_Tuple", bound=tuple[Any, ...])


def _extension() -> Any:
    """The extension module, or None."""
    if os.environ.get(OFF) == "0":
        return None
    try:
        return importlib.import_module("drivers.native.path")
    except ImportError:
        return None


def _plain_copy(to: memoryview, begin: int, source: memoryview) -> None:
    """The bytes of `source` into `to`, from byte `begin` on; both of bytes. Raises ValueError where they do not fit."""
    to[begin : begin + len(source)] = source


path: Final[Any] = _extension()
copy: Final[Callable[[memoryview, int, memoryview], None]] = path.copy if path else _plain_copy
tuple_as: Final[Callable[[type[_Tuple], Sequence[Any]], _Tuple]] = path.tuple_as if path else tuple.__new__
