"""A run whose axis 0 moves onto a limit switch of its drive."""

from hil.cycle.fault_table import Fault
from hil.virtual.lockstep import LockstepRun


def assert_switch_stops(run: LockstepRun) -> None:
    """Within 2000 ticks axis 0 latches LIMIT_SWITCH, told for the end it is at."""
    while not run.cycle.fault:
        run.tick()
        assert run.index < 2000
    assert run.cycle.fault is Fault.LIMIT_SWITCH
    (evidence,) = run.cycle.monitor.armed_evidence()
    assert (evidence.axis, evidence.value) == (0, 0.0 if run.true_position[0] < 0 else 1.0)
