"""Our own laws by name, and the way to the class of any law, ours or a user's (drivers/plugins.py)."""

import re
from typing import Any

from drivers import plugins
from drivers.plugins import Kind
from hil.rig.schema import LawConfig

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
KIND = Kind("law", "laws", "law", "name", "hil.laws", LAWS, ("reset", "force"))


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
