"""The CANopen master's side of one drive: finds it, configures it over SDO, starts it, follows its states.

Rules. Steps are made in order, one SDO transfer at a time. A required one that is aborted or reads another value
refuses the drive, with a reason for people; after a while it is tried again from the start. A required one without an
answer is asked again, for ever, and told. An optional write that is aborted, or gets no answer twice, is left out;
after silence so are the other values of that object.

At the end every value that was written is read back, and 6061h with it. Another value, an abort, or twice no answer
refuses the drive by the object's name. Only what was left out when it was to be written is not read back. What a
drive's application was told (6000h and above) is read back again after every fault reset, by the same rules. Where a
value has changed by then, the drive is configured anew.

A boot-up message starts over at any time, so a drive may boot late, or twice. A drive that was lost (neither heartbeat
nor TPDO) is configured anew.

Time is counted in ticks (calls of `HostProtocol.encode`): the master has no clock.
"""

from collections.abc import Sequence
from enum import Enum, auto
from typing import Final, NamedTuple

from drivers.eds.reader import object_name
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort, DriveState, Emergency, NmtCommand, NmtState
from drivers.families.cia402.emergency import emergency_words
from drivers.families.cia402.errand import Errand
from drivers.families.cia402.sdo import Progress, Step, Transfer, describe_abort
from drivers.frame import Frame
from drivers.protocols.base import DriveStatus

SDO_TIMEOUT_TICKS = 100
MOST_ASKED = 2  # times, for a step that is optional or reads back
APPLICATION = 0x6000  # first object of a drive's own profile
RETRY_TICKS = 1000  # after a refusal, before the node is asked again from the start
LOST_TICKS = 500  # no heartbeat and no TPDO for so long: the node is gone

_WATCHDOG, _ENCODER_FAULT = int(DriveStatus.WATCHDOG), int(DriveStatus.ENCODER_FAULT)


class Phase(Enum):
    """Where the master is with a node."""

    CONFIGURE = auto()
    START = auto()
    RUNNING = auto()
    REFUSED = auto()


_START: Final = Phase.START  # what every answer asks for: a member costs 300 instructions where it is found by name
RUNNING: Final = Phase.RUNNING


class Answer(NamedTuple):
    """What the drive answered to a step, for people."""

    step: Step
    text: str


class NodeMaster:
    """One drive as the master sees it.

    phase: progress. state: of its power state machine, None before the first TPDO. alarms: DriveStatus bits its
    emergency messages stand for. emergency: the last of them that is not over, for people. problem: why it was refused,
    or that it is silent, for people. answers: to the steps since it was last begun with. values: what was read from it,
    by index and sub-index. errand: accesses while it runs, None where there are none; it ends with the configuration.
    away: its mode is not the one it was configured with, as it homes by itself. homes: it is told to.
    """

    def __init__(self, node_id: int, steps: Sequence[Step], *, autostart: bool = False) -> None:
        """autostart: it goes to operational by itself and is not started by NMT."""
        self.node_id = node_id
        self._steps = tuple(steps)
        proofs = [at for at, step in enumerate(steps) if step.proof and step.object_index >= APPLICATION]
        self._application = proofs[0] if proofs else len(self._steps)  # what is read back after a fault
        self._autostart = autostart
        self.problem = ""
        self.emergency = ""
        self.answers: list[Answer] = []
        self._silent = False  # the problem is that it does not answer
        self.values: dict[tuple[int, int], int] = {}
        self._tick = 0
        self._heard_tick = 0
        self._closing = b""  # of a transfer that is over
        self.errand: Errand | None = None
        self.away = self.homes = False
        self._asked_tick = -1
        self.restart()

    def restart(self) -> None:
        """The node is to be configured from the start: it booted, or was lost."""
        self.away = self.homes = False
        self._enter(Phase.CONFIGURE)
        self.state: DriveState | None = None
        self.alarms = 0
        self.emergency, self._closing = "", b""
        self.answers.clear()
        self._left_out: set[tuple[int, int]] = set()  # places that were to be written
        self._mute: set[int] = set()  # objects that did not answer a write
        self._proving = False  # after a fault
        self._begin(0)

    # what it says -----------------------------------------------------------------------------------------------------

    def on_heartbeat(self, state: int) -> None:
        """A heartbeat, or the boot-up message."""
        self._heard_tick = self._tick
        if state == NmtState.BOOT_UP:
            self.restart()
        elif self.phase is Phase.RUNNING and state != NmtState.OPERATIONAL:
            self._enter(Phase.START)

    def on_state(self, state: DriveState) -> None:
        """The state in a TPDO."""
        recovered = self.state is DriveState.FAULT and state is not DriveState.FAULT
        self.state = state
        if recovered:
            self.alarms, self.emergency = 0, ""
            if self.away:
                self.restart()
            else:
                self._prove()
        self.on_pdo()

    def on_pdo(self) -> None:
        """A TPDO: it lives, and runs where it was told to."""
        self._heard_tick = self._tick
        if self.phase is _START:
            self._enter(RUNNING)

    def on_mode(self, mode: int) -> None:
        """The mode in a TPDO (6061h)."""
        if self.phase is Phase.RUNNING and mode != cia301.TORQUE_MODE and not self.away:
            self.refuse(
                f"6061h = {mode:#x} in its answers; expected {cia301.TORQUE_MODE:#x}: it left the mode it was told"
            )

    def on_emergency(self, data: bytes) -> None:
        """An emergency message of 8 bytes: the reason of a fault that the statusword does not tell."""
        code = data[0] | data[1] << 8
        self.emergency = "" if code == Emergency.NONE else f"node {self.node_id}: {emergency_words(data)}"
        if code == Emergency.NONE:
            self.alarms = 0
        elif code in (Emergency.HEARTBEAT, Emergency.RPDO_TIMEOUT):
            self.alarms |= _WATCHDOG
        elif code & 0xFF00 == Emergency.SENSOR:
            self.alarms |= _ENCODER_FAULT

    def take_on(self, errand: Errand) -> None:
        """Run it next; it fails at once where the drive does not run."""
        if self.phase is RUNNING:
            self.errand = errand
        else:
            errand.fail(f"node {self.node_id} does not run")

    def on_sdo(self, data: bytes) -> bool:
        """An SDO answer of 8 bytes; False where it is not one to the request that is open."""
        if self.errand is not None and self.phase is RUNNING:
            return self.errand.on_answer(data)
        if self._asked_tick < 0 or self.phase is not Phase.CONFIGURE:
            return False
        transfer = self._transfer
        progress = transfer.answer(data)
        if progress is Progress.FOREIGN:
            return False
        self._asked_tick = -1
        self._closing = transfer.closing
        if self._silent:
            self._silent, self.problem = False, ""
        step = transfer.step
        if progress is Progress.ABORTED:
            aborted = f"aborted with {describe_abort(transfer.code)}"
            self._note(aborted)
            if step.proof:
                self._refuse_unproved(step, aborted)
            elif step.required:
                self.refuse(f"{object_name(step.object_index, step.subindex)} {aborted}")
            else:
                self._leave_out(step)
        elif progress is Progress.DONE and not step.size:
            self._check(step, transfer.value)
        elif progress is Progress.DONE:
            self._note("done")
            self._left_out.discard((step.object_index, step.subindex))
            self._next()
        return True

    def _check(self, step: Step, value: int) -> None:
        self.values[step.object_index, step.subindex] = value
        if value & step.mask == step.value:
            self._note(f"is {value:#x}")
            self._next()
        elif self._proving:
            self.restart()  # it lost that with the fault
        else:
            self._note(f"is {value:#x}; expected {step.value:#x} in the bits {step.mask:#x}")
            name = object_name(step.object_index, step.subindex).removesuffix(":00")
            written = ": it does not keep what is written" if step.proof else ""
            self.refuse(f"{name} = {value:#x}; expected {step.value:#x} in the bits {step.mask:#x}{written}")

    def _prove(self) -> None:
        """Read back what the drive's application was told; until that is done it is not enabled."""
        if self.phase is Phase.RUNNING and self._application < len(self._steps):
            self._enter(Phase.CONFIGURE)
            self._proving = True
            self._go_on(self._application)

    def _leave_out(self, step: Step) -> None:
        self._left_out.add((step.object_index, step.subindex))
        self._next()

    def _refuse_unproved(self, step: Step, answered: str) -> None:
        """What cannot be read back is not believed."""
        self.refuse(f"{object_name(step.object_index, step.subindex)} {answered} when it was read back")

    def _note(self, text: str) -> None:
        """The answer to the step under way; one that is asked again has its last."""
        step = self._transfer.step
        if self.answers and self.answers[-1].step is step:
            self.answers.pop()
        self.answers.append(Answer(step, text))

    def _begin(self, at: int) -> None:
        """That step is under way."""
        self._step, self._asked = at, 0
        self._transfer = Transfer(self._steps[at])

    def _next(self) -> None:
        self._go_on(self._step + 1)

    def _go_on(self, at: int) -> None:
        """With the first step from there on that is not left out."""
        while at < len(self._steps) and self._is_left_out(self._steps[at]):
            at += 1
        if at < len(self._steps):
            self._begin(at)
            return
        self.problem, self._proving = "", False
        self._enter(Phase.START)

    def _is_left_out(self, step: Step) -> bool:
        place = step.object_index, step.subindex
        if step.proof:
            return place in self._left_out
        if step.required or step.object_index not in self._mute:
            return False
        self._left_out.add(place)
        return True

    def refuse(self, reason: str) -> None:
        """It cannot be used as it is; it is asked again after a while, or once it boots."""
        self.problem = f"node {self.node_id}: {reason}"
        self._enter(Phase.REFUSED)

    def _enter(self, phase: Phase) -> None:
        if self.errand is not None and phase is not RUNNING:
            self.errand.fail(f"node {self.node_id} is configured anew")
            self.errand = None
        if self.away and phase is Phase.START:
            self.restart()
            return
        self.phase = phase
        self._asked_tick = -1
        self._since_tick = self._tick

    # what it is told --------------------------------------------------------------------------------------------------

    def service(self, tick: int) -> Frame | None:
        """The frame that the node is due in this tick, if any."""
        self._tick = tick
        if self._closing:
            closing, self._closing = self._closing, b""
            return self._frame(closing)
        if self.phase is Phase.RUNNING:
            if tick - self._heard_tick > LOST_TICKS:
                self.restart()
            elif self.errand is not None:
                return self._run(self.errand)
            return None
        if self.phase is Phase.REFUSED:
            if tick - self._since_tick > RETRY_TICKS:
                self.restart()
            return None
        if self._asked_tick >= 0:
            return self._await(tick)
        self._asked_tick = tick
        if self.phase is Phase.START:
            return None if self._autostart else Frame(cia301.NMT_ID, bytes((NmtCommand.START, self.node_id)))
        return self._frame(self._transfer.request())

    def _run(self, errand: Errand) -> Frame | None:
        request = errand.request(self._tick)
        if errand.over:
            self.errand = None
            if errand.required:
                self.away = False
                if errand.problem:
                    self.refuse(errand.problem)
        return self._frame(request) if request else None

    def _await(self, tick: int) -> Frame | None:
        if tick - self._asked_tick <= SDO_TIMEOUT_TICKS:
            return None
        self._asked_tick = -1
        if self.phase is Phase.START:
            self.restart()  # it was started and sends no TPDO: perhaps it lost its configuration
            return None
        step = self._transfer.step
        self._note("no answer")
        self._asked += 1
        if not step.required and self._asked == MOST_ASKED:
            overdue = self._transfer
            if step.proof:
                self._refuse_unproved(step, "gave no answer")
            else:
                self._mute.add(step.object_index)
                self._leave_out(step)
            return self._frame(overdue.abort(Abort.TIMEOUT))
        if not self.problem:
            self._silent = True
            self.problem = f"node {self.node_id}: no answer to {object_name(step.object_index, step.subindex)}"
        overdue, self._transfer = self._transfer, Transfer(step)
        return self._frame(overdue.abort(Abort.TIMEOUT))

    def _frame(self, data: bytes) -> Frame:
        return Frame(cia301.SDO_REQUEST_ID + self.node_id, data)
