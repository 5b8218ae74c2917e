"""Where laws come from: one table for ours, and one way to load a class that serves ours and everybody else's.

A rig's `law.name` is a name of the table, a name that an installed package registers under the entry point group
`hil.laws`, `package.module:Class`, or `./file.py:Class` with a file beside the rig. Of a file, the rig carries the text
(`law.source`), so that it is part of the rig's hash, of the recording, and of the work sent to other processes.
"""

import hashlib
import importlib
import linecache
import re
import sys
from functools import lru_cache
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any

from hil.rig.schema import LawConfig

GROUP = "hil.laws"
PACKAGE = "hil.control.laws"  # of our own laws; the compiled build has them a second time (deploy/compiled/build.py)
LAWS: dict[str, str] = {
    "pd-feedforward": "hil.control.laws.pd_feedforward:PdFeedforward",
    "robust-pd": "hil.control.laws.robust_pd:RobustPd",
    "robust-pd-filtered-error": "hil.control.laws.robust_pd:FilteredErrorPd",
    "robust-pd-alpha-brackets": "hil.control.laws.robust_pd:AlphaBracketsPd",
    "pid": "hil.control.laws.pid:Pid",
    "computed-torque": "hil.control.laws.computed_torque:ComputedTorque",
    "sliding-mode": "hil.control.laws.sliding_mode:SlidingMode",
    "slotine-li": "hil.control.laws.slotine_li:SlotineLi",
    "super-twisting": "hil.control.laws.super_twisting:SuperTwisting",
    "disturbance-observer": "hil.control.laws.disturbance_observer:DisturbanceObserver",
    "structured-kalman": "hil.control.laws.structured_kalman:StructuredKalman",
    "presliding-kalman": "hil.control.laws.presliding_kalman:PreslidingKalman",
}
_METHODS = ("reset", "force")


def law_class(law: LawConfig, package: str = PACKAGE) -> Any:
    """The class a rig's [law] names. package: where our own laws are taken from.

    Raises ValueError naming law.name, its value and what is allowed; and whatever the law's own module raises, as a
    ValueError with its file and line.
    """
    name = law.name
    if name in LAWS:
        return load(LAWS[name].replace(PACKAGE, package, 1))
    if ":" not in name:
        return _registered(name)
    module, _, attribute = name.rpartition(":")
    if module.endswith(".py"):
        return _attribute(_from_source(module, law.source), attribute, name)
    return load(name)


def file_name(law: str) -> str:
    """The name of a law as a part of file names: './lqr.py:Lqr' is lqr.py-Lqr."""
    return re.sub(r"[^A-Za-z0-9_.]+", "-", law).strip("-.") or "law"


def is_built_in(law: LawConfig) -> bool:
    """Whether the law is one of ours."""
    return law.name in LAWS


def registered() -> list[str]:
    """Names of all laws that can be had by name: ours, then those of installed packages."""
    others = {entry.name for entry in entry_points(group=GROUP)}
    return [*LAWS, *sorted(others - LAWS.keys())]


def load(target: str) -> Any:
    """The class `package.module:Class`. Raises ValueError where it is not to be had, or is no law."""
    module, _, attribute = target.partition(":")
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        raise ValueError(f"law.name = {target!r}: {error}") from None
    except Exception as error:
        raise ValueError(f"law.name = {target!r}: importing it failed: {where(error)}") from error
    return _attribute(found, attribute, target)


def where(error: BaseException) -> str:
    """The file, line, kind and text of an exception, of the innermost frame it came through."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}: " if trace is not None else ""
    return f"{place}{type(error).__name__}: {error}"


def _registered(name: str) -> Any:
    for entry in entry_points(group=GROUP):
        if entry.name == name:
            return load(entry.value)
    raise ValueError(
        f"law.name = {name!r}: the laws are {', '.join(registered())}; or 'package.module:Class', or './file.py:Class' "
        "of a file beside the rig"
    )


def _attribute(module: ModuleType, attribute: str, target: str) -> Any:
    found = getattr(module, attribute, None)
    if not isinstance(found, type) or not all(callable(getattr(found, method, None)) for method in _METHODS):
        raise ValueError(f"law.name = {target!r}: {attribute!r} is no class with {' and '.join(_METHODS)}")
    return found


@lru_cache(maxsize=64)
def _from_source(file: str, source: str) -> ModuleType:
    """A module from the text of a law's file: executed once for every text."""
    if not source:
        raise ValueError(f"law.name = '{file}:...': law.source is empty; load the rig from its file")
    digest = hashlib.sha256(f"{file}\0{source}".encode()).hexdigest()[:16]
    module = ModuleType(f"hil_law_{digest}")
    module.__file__ = file
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)  # for tracebacks
    sys.modules[module.__name__] = module  # dataclasses look their module up
    try:
        exec(compile(source, file, "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[module.__name__]
        place = f"{file}:{error.lineno}: {error.msg}" if isinstance(error, SyntaxError) else where(error)
        raise ValueError(f"law.name = '{file}:...': {place}") from error
    return module
