"""Where the axes come to rest after an injection on the way into the fence, by the plant's own position.

Demanded of each axis: it stays inside its travel as long as it has torque, so where it goes on and where an operator
stops it. Without torque it goes on no further than friction lets it coast.
"""

from hil.control.estimator.gains import per_axis
from hil.cycle.fault_monitor import REACTIONS
from hil.cycle.fault_table import Reaction
from hil.cycle.state_machine import TORQUE_STATES, State
from hil.rig.tables import AxisConfig
from hil.studies.fault_campaign.checkpoints import CampaignRun
from hil.studies.fault_campaign.trial import BY_MOTION, Trial, watchdog

LOST_TICKS = 3  # of motion under the last torque: two lost frames included; more where the drives do not hear the host


def coast(axis: AxisConfig, speed: float, *, braked: bool) -> float:
    """How far an axis without torque may go on from `speed`, m/s: m (rad); infinite where friction does not stop it."""
    friction = axis.model.coulomb - (0.0 if braked else abs(axis.model.gravity))
    return 0.5 * axis.model.mass * speed * speed / friction if friction > 0.0 else float("inf")


class TravelWatch:
    """What is seen of the axes' true positions since an injection. beyond: m (rad) beyond the travel, at most, by axis.
    speed: the greatest since the state last permitted torque, by axis.
    """

    def __init__(self, run: CampaignRun) -> None:
        self._run = run
        self.beyond = [0.0] * len(run.rig.axes)
        self.speed = [0.0] * len(run.rig.axes)

    def look(self) -> None:
        """After a tick."""
        run = self._run
        places, speeds = run.true_position.tolist(), [abs(speed) for speed in run.true_velocity.tolist()]
        powered = run.cycle.state in TORQUE_STATES
        self.speed = speeds if powered else [max(pair) for pair in zip(self.speed, speeds, strict=True)]
        for number, axis in enumerate(run.rig.axes.values()):
            low, high = axis.limits.position
            self.beyond[number] = max(self.beyond[number], places[number] - high, low - places[number])

    def failure(self, trial: Trial) -> str:
        """Why an axis is not where it may be; empty where all are, or where the trial itself moves them."""
        run = self._run
        if not set(trial.faults).isdisjoint(BY_MOTION):
            return ""
        falls = run.cycle.fault or run.cycle.state is State.ESTOP or run.restarted
        unheard = REACTIONS[run.cycle.fault] is Reaction.SILENT or run.restarted or bool(trial.slack)
        late = LOST_TICKS + (watchdog(run.rig) if unheard else 0)
        braked = per_axis(run.rig.drives.brake, len(run.rig.axes))
        for number, (name, axis) in enumerate(run.rig.axes.items()):
            speed = self.speed[number]
            way = coast(axis, speed, braked=bool(braked[number])) + late * run.rig.period_ns * 1e-9 * speed
            allowed = way if falls else 0.0
            if self.beyond[number] > allowed:
                return f"{name}: {self.beyond[number]:.3g} beyond its travel, allowed {allowed:.3g}"
        return ""
