"""Which build of the control path runs. Imports nothing: the command line asks it before all else."""

from importlib.util import find_spec


def control_path() -> str:
    """ "interpreted" or "compiled", by what Python would load as the control cycle itself."""
    found = find_spec("hil.cycle.step")
    origin = found.origin if found else None
    return "interpreted" if origin is None or origin.endswith(".py") else "compiled"
