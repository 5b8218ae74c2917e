"""The control process ends in the middle of whatever it does, and systemd starts another one.

What the drives latched meanwhile is for the operator to reset; nothing may go on by itself.
"""

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.checkpoints import CampaignRun
from hil.studies.fault_campaign.layout_capabilities import Capability
from hil.studies.fault_campaign.trial import Limit, Step, Trial, ticks, watchdog

_BRIEFLY = 2  # ticks: no drive has noticed
_RESET_EVERY = 100  # ticks: one that meets drives which are still being configured clears nothing
_CONFIGURED = 1000  # ticks in which any drives are, and have been reset since (the microscope over cia402: 770)


def _long(rig: RigConfig) -> int:
    return watchdog(rig) + 2


def _restarted(after: Limit) -> Step:
    """Another process `after` ticks later."""

    def step(run: CampaignRun, axis: int, k: int) -> None:
        if k == 0:
            run.skip(ticks(after, run.rig))
            run.restart()

    return step


def _restarted_and_reset(run: CampaignRun, axis: int, k: int) -> None:
    """Another process; the operator resets until the rig is READY."""
    _restarted(_long)(run, axis, k)
    if k % _RESET_EVERY == _RESET_EVERY // 2 and run.cycle.state is State.CONNECTED:
        run.asks = CommandKind.RESET


def _as_found(run: CampaignRun) -> set[State]:
    """Where the new process may get to by itself."""
    return {State.CONNECTED} if run.latched else {State.CONNECTED, State.READY}


def _as_reset(run: CampaignRun) -> set[State]:
    """Where the operator gets the new process to; drives that hear no reset keep what they latched."""
    return {State.CONNECTED} if run.latched and not run.cycle.protocol.resets else {State.READY}


RESTARTS = (
    Trial(
        "started again at once", _restarted(_BRIEFLY), per_axis=False, ends=_as_found, slack=watchdog, watch=_CONFIGURED
    ),
    Trial(
        "started again, the drives have tripped", _restarted(_long), per_axis=False, ends=_as_found, watch=_CONFIGURED
    ),
    Trial(
        "started again, and the operator resets",
        _restarted_and_reset,
        per_axis=False,
        ends=_as_reset,
        needs=Capability.RESET,
        watch=_CONFIGURED,
    ),
)
