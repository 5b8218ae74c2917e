"""Our own laws by name, and what a law of users has to have."""

from drivers.base.plugins import Kind

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
EXPERIMENT = "hil.identify.excitation:Excitation"  # what `hil identify` runs
KIND = Kind("law", "laws", "law", "name", "hil.laws", LAWS, ("reset", "force"), (EXPERIMENT,))
