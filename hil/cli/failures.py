"""What is printed, and with which exit status, where a command fails by what its user gave it."""

import errno

from drivers.base.text_file import printable
from hil.cli.exit_status import EXIT_CONFIG, EXIT_FILE, EXIT_UNAVAILABLE
from hil.cli.streams import unwritable_output

_NO_ROOM = "failed to map segment"  # of the loader, for a library that does not fit into memory
_NO_REASON = "without setting an exception"  # of C code that had no memory left to say so
_NO_FOLDER = "No usable temporary directory"  # of tempfile, where files cannot be written anywhere
_OF_THIS_COMPUTER = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EMFILE, errno.ENFILE)


def failure(error: Exception) -> tuple[int, list[str]]:
    """(exit status, lines for people); raises `error` itself where it is a mistake of ours.

    The classes are imported once something has failed: they stand beside half a second of rig schema.
    """
    from drivers.base.runtime import RuntimeDirectoryError
    from drivers.protocols.base import LayoutError
    from hil.rig.schema import RigError
    from hil.rig.shipped import IncompleteError
    from sim_plant.config import PlantError

    if isinstance(error, RigError):
        return EXIT_CONFIG, _lines(*error.problems)
    if isinstance(error, PlantError | LayoutError):
        return EXIT_CONFIG, _lines(error)
    if isinstance(error, RuntimeDirectoryError | IncompleteError):
        return EXIT_UNAVAILABLE, _lines(error)
    if isinstance(error, OSError) and error.filename is not None:
        return EXIT_FILE, _lines(f"{error.filename}: {error.strerror}")
    if isinstance(error, OSError) and _NO_FOLDER in (error.strerror or ""):
        return EXIT_FILE, _lines(error.strerror)
    if isinstance(error, OSError) and error.errno in _OF_THIS_COMPUTER:
        return EXIT_FILE, _lines(unwritable_output("\n") or error.strerror)
    of_memory = {ImportError: _NO_ROOM, SystemError: _NO_REASON}.get(type(error))
    if isinstance(error, MemoryError) or (of_memory and of_memory in str(error)):
        return EXIT_UNAVAILABLE, _lines("not enough memory; `ulimit -v` and `free -m` say how much there is")
    raise error


def _lines(*problems: object) -> list[str]:
    return [printable(f"hil: {problem}") for problem in problems]
