"""The way to the class of any law, ours (hil/rig/law_names.py) or a user's (drivers/base/plugins.py)."""

import re
from typing import Any

from drivers.base import plugins
from hil.rig.law_names import KIND, LAWS
from hil.rig.schema import LawConfig

PACKAGE = "hil.control.laws"  # of our own laws; the compiled build has them a second time (deploy/compiled/build.py)


def law_class(law: LawConfig, package: str = PACKAGE) -> Any:
    """The class a rig's [law] names. package: where our own laws are taken from. Raises ValueError as plugins.find."""
    if law.name in LAWS:
        return plugins.load(LAWS[law.name].replace(PACKAGE, package, 1))
    return plugins.find(KIND, law.name, law.source)


def file_name(law: str) -> str:
    """The name of a law as a part of file names: './lqr.py:Lqr' is lqr.py-Lqr."""
    return re.sub(r"[^A-Za-z0-9_.]+", "-", law).strip("-.") or "law"


def is_built_in(law: LawConfig) -> bool:
    """Whether the law is one of ours."""
    return law.name in LAWS


def registered() -> list[str]:
    """Names of all laws that can be had by name: ours, then those of installed packages."""
    return plugins.registered(KIND)
