"""The control service: one pure control cycle and the shells that run it live, in lockstep, or from a recording.

What Python programs use of it is listed in the stub beside this file (hil/__init__.pyi), which type checkers and
editors read, and loaded when it is first asked for: `import hil` itself loads nothing. Everything else may change from
one version to the next.
"""

import os
import sys
from importlib.machinery import PathFinder

# Nothing in hil calls BLAS (bit determinism forbids it). One thread, set before numpy is imported, saves each process
# 40 MB and an idle thread beside the real-time loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _public() -> dict[str, str]:
    """Modules by public name. The stub is the one list of them; its lines read `from MODULE import NAME as NAME`."""
    homes: dict[str, str] = {}
    with open(os.path.join(os.path.dirname(__file__), "__init__.pyi"), encoding="utf-8") as stub:
        for line in stub:
            if line.startswith("from "):
                _, module, _, name, *_ = line.split()
                homes[name] = module
    return homes


def _refuse_shadows() -> None:
    """Raises ImportError where a folder of the same name hides one of the two packages that come with this one."""
    home = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    for name in ("drivers", "sim_plant"):
        loaded = sys.modules.get(name)
        spec = loaded.__spec__ if loaded else PathFinder.find_spec(name)
        if spec is None or spec.origin is None:
            continue
        found, own = os.path.dirname(os.path.realpath(spec.origin)), os.path.join(home, name)
        if found != own and os.path.isdir(own):
            raise ImportError(
                f"{found} hides the package '{name}' of hil, which has the same name: rename that folder, or start "
                f"Python where it is not the first that is found (hil's own is {own})"
            )


_refuse_shadows()


def _loaded(home: str, name: str) -> object:
    """The module that has a public name. Raises ImportError where it is not in what is installed."""
    try:
        return __import__("importlib").import_module(home)
    except ModuleNotFoundError as error:
        if error.name != home and not home.startswith(f"{error.name}."):
            raise
        raise ImportError(f"hil.{name} is not part of hil-client, which watches and moves rigs: install hil") from None


def __getattr__(name: str) -> object:
    if name == "__all__":
        value: object = sorted(_public())
    elif name.startswith("_") or (home := _public().get(name)) is None:
        raise AttributeError(f"module 'hil' has no attribute {name!r}")
    else:
        value = getattr(_loaded(home, name), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_public()})
