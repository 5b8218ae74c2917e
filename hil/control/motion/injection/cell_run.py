"""One cell, from the way there to the lift: phases, each of which ends by evidence or at a limit.

| phase | ends by | else |
|---|---|---|
| approach | at rest above the cell; the camera sees the tip where the encoder has it | broken |
| tare | 64 samples | |
| seek | the force rises: contact | no cell, rolled |
| press | puncture, as the z_law sees it | not pierced: at the force limit, or at the deepest place |
| freeze, advance | at the depth of deposit | double: the force drops once more |
| pulse, confirm | a frame exposed 100 ms after the pulse shows the bolus | clogged, camera frozen; rolled: no pulse |
| withdraw, lift | at the safe height, the force at zero | stuck |

In every phase behind the approach a force sensor or a camera that says nothing new ends the injection. The pulse is
given only behind a puncture that was seen, and a frame that shows the cell in its place. A pulse that the gate cut
is given to its end; where it cannot be, a bolus that is missing makes the cell unknown, not clogged.
"""

from collections.abc import Callable
from math import sqrt

from hil.control.motion.contract import Observation
from hil.control.motion.glide import Glide
from hil.control.motion.injection.detectors import Slip, Slope
from hil.control.motion.injection.senses import Senses
from hil.control.motion.injection.settings import Settings
from hil.control.motion.injection.verdict import CellResult, Phase, Verdict
from hil.control.motion.injection.z_laws import DROP_NOISE, Hold, z_law

SLIP_TICKS = 6  # until the force of a pierced membrane is gone, unless another one carries the tip before
SLOPE_TICKS = 12
LOOK_AHEAD_TICKS = 4  # from a sample to the place where the tip can be made to stop: two of delay, two of braking
AFTER_PULSE_S = 0.1  # that a frame is exposed after the pulse's beginning which shows the bolus
PULSE_SPAN = 1.5  # times its length: within this a pulse that was cut is ended
PATIENCE_S = 0.2  # for that frame beyond this and the camera's latency
_SEEN_LATER = (
    Verdict.NO_CELL,
    Verdict.NOT_PIERCED,
    Verdict.DOUBLE,
    Verdict.BURST,
)  # a cell that rolls away can look like any of these
_BOLUS = "the bolus that the camera sees"
ZERO_NOISE = 5.0
ZERO_SAMPLES = 16


class CellRun:
    """over: the cell is done, the tip at the safe height. pulse: the valve is to be open. halted: go no further."""

    def __init__(self, number: int, settings: Settings, senses: Senses, glide: Glide, axis: int, period: float) -> None:
        self.result = CellResult(number)
        self._s, self._senses, self._z, self._axis = settings, senses, glide, axis
        self._period = period
        self._top = settings.cells[number][2]
        self._law = z_law(settings, senses, glide, axis, period)
        self._slope = Slope(SLOPE_TICKS)
        self._slip = Slip(SLIP_TICKS, DROP_NOISE * senses.noise)
        self._since = self._decided = 0
        self._zeros: list[float] = []
        self.phase = Phase.NONE
        self.pulse = self.over = False
        self._open = 0  # ticks of the pulse
        self._steps: dict[Phase, Callable[[Observation], None]] = {
            Phase.APPROACH: self._approach, Phase.TARE: self._tare, Phase.SEEK: self._seek, Phase.PRESS: self._press,
            Phase.FREEZE: self._freeze, Phase.ADVANCE: self._advance, Phase.PULSE: self._give_pulse,
            Phase.CONFIRM: self._confirm, Phase.WITHDRAW: self._withdraw, Phase.LIFT: self._lift,
        }  # fmt: skip

    def begin(self, seen: Observation) -> None:
        """Above the cell, at the safe height."""
        self.result.began_s = seen.tick * self._period
        self._go(Phase.APPROACH, seen)
        self._to(seen, self._top - self._s.direction * self._s.start_above, self._s.transfer_speed)

    def step(self, seen: Observation) -> None:
        """One tick, behind the senses'."""
        deep = Phase.SEEK <= self.phase <= Phase.CONFIRM
        if self.phase >= Phase.SEEK and self._senses.fresh:
            self.result.peak_force = max(self.result.peak_force, self._senses.force)
        if deep and self._senses.dead:
            self.decide(Verdict.SENSOR_DEAD, "the force sensor shows nothing new", seen)
        elif deep and self._senses.frozen:
            self.decide(Verdict.CAMERA_FROZEN, "the newest frame is too old", seen)
        elif Phase.SEEK <= self.phase < Phase.PULSE and self._rolled():
            self.decide(Verdict.ROLLED, "the cell has moved", seen)
        else:
            self._steps[self.phase](seen)

    def decide(self, verdict: Verdict, evidence: str, seen: Observation) -> None:
        """The first verdict counts, except after OK, where a worse one does; the tip leaves the cell."""
        if self.result.verdict in (Verdict.NONE, Verdict.OK):
            self.result.verdict, self.result.evidence = verdict, evidence
            self._decided = seen.tick
        self.pulse = False
        if self.phase < Phase.WITHDRAW:
            self._go(Phase.WITHDRAW, seen)
            self._to(seen, self._top - self._s.direction * self._s.start_above, self._s.withdraw_speed)

    @property
    def touched(self) -> bool:
        """The tip has pressed on the cell: it cannot be begun anew."""
        return self.phase >= Phase.PRESS

    def leave(self, evidence: str, seen: Observation) -> None:
        """By request: out of a cell that is touched. Where its pulse was given, nobody has seen whether it came out."""
        if self.phase < Phase.WITHDRAW:
            pulsed = self.phase is Phase.CONFIRM
            self.result.left = True
            self.decide(Verdict.UNKNOWN if pulsed else Verdict.SKIPPED, evidence, seen)

    def interrupted(self) -> CellResult:
        """The rig has stopped in this cell: nobody can say that all is well with it."""
        result = self.result
        if result.verdict in (Verdict.NONE, Verdict.OK):
            result.verdict, result.left = Verdict.UNKNOWN, True
            result.evidence = f"the rig stopped in {self.phase.name.lower()}"
        return result

    # ------------------------------------------------------------------------------------------------------------------

    def _go(self, phase: Phase, seen: Observation) -> None:
        self.phase, self._since = phase, seen.tick

    def _to(self, seen: Observation, place: float, speed: float) -> None:
        self._z.to(seen.ends_ns[self._axis], seen.reference[self._axis], place, speed)

    def _rests(self, seen: Observation) -> bool:
        return self._z.rests(seen.ends_ns[self._axis])

    def _elapsed(self, seen: Observation) -> float:
        return (seen.tick - self._since) * self._period

    def _rolled(self) -> bool:
        shift = self._senses.shift
        return shift is not None and shift.exposed >= self._since and abs(shift.value) > self._s.roll_limit

    def _approach(self, seen: Observation) -> None:
        if not self._rests(seen) or self._elapsed(seen) < self._s.settle_s:
            return
        tip = self._senses.tip
        if tip is not None and (tip.frozen or abs(tip.value) > self._s.tip_limit):
            verdict = Verdict.CAMERA_FROZEN if tip.frozen else Verdict.BROKEN
            self.decide(verdict, "the camera does not see the tip where it should be", seen)
            return
        self._senses.begin_tare()
        self._go(Phase.TARE, seen)

    def _tare(self, seen: Observation) -> None:
        if self._senses.tared():
            self._go(Phase.SEEK, seen)
            self._law.search(seen, self._top)
        elif self._senses.dead:
            self.decide(Verdict.SENSOR_DEAD, "the force sensor shows nothing new", seen)

    def _seek(self, seen: Observation) -> None:
        self._law.step(seen)
        contact = self._law.touch()
        if contact is not None:
            self.result.found, self.result.found_s = self._senses.place, seen.tick * self._period
            self.result.contact = contact
            self._slope.restart()
            self._go(Phase.PRESS, seen)
            self._law.press(seen, contact)
        elif self._senses.force > self._s.force_limit:
            self.decide(Verdict.NOT_PIERCED, "the force limit, before a touch was seen", seen)
        elif self._law.rests(seen):
            self.decide(Verdict.NO_CELL, "no touch down to the deepest place", seen)

    def _press(self, seen: Observation) -> None:
        senses = self._senses
        self._law.step(seen)
        if self._law.pierces():
            self._pierced(seen)
            return
        if isinstance(self._law, Hold) and self._law.held:
            self.result.held_rms = self._law.rms
            self.decide(Verdict.HELD, "the force was held", seen)
            return
        if senses.fresh:
            self._slope.take(senses.place, senses.force)
            ahead = self._slope.value * LOOK_AHEAD_TICKS * self._s.direction * self._s.press_speed * self._period
            if senses.force + max(ahead if self._law.dives else 0.0, 0.0) > self._s.force_limit:
                self.decide(Verdict.NOT_PIERCED, "the force limit", seen)
                return
        if self._law.rests(seen):
            self.decide(Verdict.NOT_PIERCED, "the deepest place", seen)

    def _pierced(self, seen: Observation) -> None:
        result = self.result
        result.pierced, result.pierced_force = self._senses.place, self._law.force
        result.pierced_s = seen.tick * self._period
        result.pierced_speed = abs(seen.velocity[self._axis])
        if isinstance(self._law, Hold):
            self.decide(Verdict.BURST, "the force dropped while it was to be held", seen)
            return
        if self._law.stops:
            self._z.stop(seen.ends_ns[self._axis], seen.reference[self._axis])
        self._go(Phase.FREEZE, seen)

    def _freeze(self, seen: Observation) -> None:
        """The tip runs on while it stops: far enough, at times, for the other side of the cell."""
        if not self._law.stops:
            self._law.step(seen)
        if self._slip.take(self._senses.force):
            self._law.forget()
        elif self._slip.over and self._pierces_again(seen):
            return
        at_rest = self._rests(seen) if self._law.stops else self._law.rests(seen)
        if self._elapsed(seen) < self._s.freeze_s or not at_rest:
            return
        self.result.rested = seen.position[self._axis]
        self._go(Phase.ADVANCE, seen)
        depth = (self._z.target - self.result.contact) * self._s.direction
        if self._law.stops and depth < self._s.deposit:
            self._to(seen, self.result.contact + self._s.direction * self._s.deposit, self._s.press_speed)

    def _advance(self, seen: Observation) -> None:
        if self._pierces_again(seen):
            return
        if self._senses.force > self._s.force_limit:
            self.decide(Verdict.NOT_PIERCED, "the force limit behind the puncture", seen)
        elif self._rests(seen):
            self.result.deposit = (seen.position[self._axis] - self.result.contact) * self._s.direction
            self._go(Phase.PULSE, seen)

    def _pierces_again(self, seen: Observation) -> bool:
        if self._law.pierces():
            self.decide(Verdict.DOUBLE, "the force dropped a second time", seen)
            return True
        return False

    def _give_pulse(self, seen: Observation) -> None:
        """Once a frame that was exposed at the depth of deposit shows the cell in its place."""
        shift = self._senses.shift
        if self._rolled():
            self.decide(Verdict.ROLLED, "the cell has moved: no pulse", seen)
        elif shift is None or shift.exposed >= self._since:
            self.result.pulse_s = seen.tick * self._period
            self.pulse = bool(self._s.valve)
            self._go(Phase.CONFIRM, seen)

    def _confirm(self, seen: Observation) -> None:
        elapsed, bolus = self._elapsed(seen), self._senses.bolus
        self._keep_open(seen, elapsed)
        if elapsed < self._s.dwell_s:
            return
        if bolus is None or not self._s.valve:
            self.decide(Verdict.UNKNOWN, "nothing shows the bolus", seen)
        elif bolus.exposed - self._since >= AFTER_PULSE_S / self._period:
            self.result.bolus = bolus.value
            if bolus.value >= self._s.bolus_least:
                self.decide(Verdict.OK, _BOLUS, seen)
            elif self._given < self._s.pulse_s:
                given, wanted = (f"{seconds * 1e3:.0f} ms" for seconds in (self._given, self._s.pulse_s))
                self.decide(Verdict.UNKNOWN, f"the valve was open for {given} of a pulse of {wanted}", seen)
            else:
                self.decide(Verdict.CLOGGED, _BOLUS, seen)
        elif elapsed > AFTER_PULSE_S + PATIENCE_S + self._s.camera_latency_s:
            self.decide(Verdict.CAMERA_FROZEN, "no frame behind the pulse", seen)

    def _keep_open(self, seen: Observation, elapsed: float) -> None:
        """Open the valve for the time of a pulse. A tick with a fault closes it until it has not been asked for once;
        it is then asked for anew.
        """
        self._open += seen.outputs != 0
        wanted, cut = self._s.pulse_s, self.pulse and not seen.outputs
        self.pulse = bool(self._s.valve) and not cut and self._given < wanted and elapsed < PULSE_SPAN * wanted

    @property
    def _given(self) -> float:
        """How long the valve has been open, s."""
        return self._open * self._period

    def _withdraw(self, seen: Observation) -> None:
        if self._senses.fresh:
            self.result.pull = max(self.result.pull, -self._senses.force)
        if not self._rests(seen):
            return
        if self.result.pull > self._s.pull_limit:
            self._stuck("the pull on the way out", seen)
        self._zeros.clear()
        self._go(Phase.LIFT, seen)

    def _lift(self, seen: Observation) -> None:
        """The force has to be back at zero before the way to the safe height begins."""
        if self._senses.fresh:
            self._zeros.append(self._senses.force)
        lifted = self._z.target == self._s.safe
        if not lifted and self._looks_again(seen):
            return
        if not lifted and (len(self._zeros) >= ZERO_SAMPLES or self._senses.dead):
            self._look_for_zero(seen)
            self._to(seen, self._s.safe, self._s.transfer_speed)
        elif lifted and self._rests(seen):
            self.result.ended_s = seen.tick * self._period
            self.over = True

    def _looks_again(self, seen: Observation) -> bool:
        """Whether the cell has rolled, a frame tells that was exposed behind the attempt; whether it is waited for."""
        shift, result = self._senses.shift, self.result
        if shift is None or result.verdict not in _SEEN_LATER:
            return False
        if shift.exposed >= self._decided and abs(shift.value) > self._s.roll_limit:
            result.verdict, result.evidence = Verdict.ROLLED, f"the cell has moved; before that: {result.evidence}"
        return shift.exposed < self._decided and not shift.frozen

    def _look_for_zero(self, seen: Observation) -> None:
        if not self._zeros:
            return
        mean = sum(self._zeros) / len(self._zeros)
        if abs(mean) > ZERO_NOISE * self._senses.noise / sqrt(len(self._zeros)) + ZERO_NOISE * self._senses.noise:
            self._stuck("a force that stays outside the cell", seen)

    def _stuck(self, evidence: str, seen: Observation) -> None:
        if self.result.verdict in (Verdict.OK, Verdict.UNKNOWN, Verdict.CLOGGED, Verdict.SKIPPED, Verdict.HELD):
            self.result.verdict = Verdict.NONE
            self.decide(Verdict.STUCK, evidence, seen)
