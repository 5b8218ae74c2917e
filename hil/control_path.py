"""Whether the control path of this process is interpreted, as ever, or was compiled by `make compiled`."""

from importlib.util import find_spec


def control_path() -> str:
    """ "interpreted" or "compiled", by what Python would load as the control cycle itself."""
    found = find_spec("hil.cycle.step")
    origin = found.origin if found else None
    return "interpreted" if origin is None or origin.endswith(".py") else "compiled"
