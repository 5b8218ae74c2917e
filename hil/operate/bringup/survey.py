"""The survey of a rig's drives, without torque: listen, scan, configure, compare.

Rules. Nothing is sent before it is known that nobody else commands these drives: a command frame heard while listening
ends the survey. A CANopen bus is then scanned for nodes, of the rig or not. After that the rig's own host runs as in
`hil run`, with zero force and every drive disabled: it configures the drives, and they send what they send.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from drivers.eds.reader import object_name
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import NmtState
from drivers.families.cia402.drive_plan import DrivePlan
from drivers.families.cia402.master import SERVICE_TICKS
from drivers.families.cia402.node import NodeMaster, Phase
from drivers.families.cia402.node_scan import NodeIdentity, NodeScan
from drivers.families.cia402.profile import MASTER_ID
from drivers.frame import ECHO, Frame
from drivers.protocols.base import SERVICE, DriveStatus, fixed_bits
from hil.operate.bringup.drive_host import DriveHost
from hil.operate.bringup.frame_log import Comparison, FrameLog, compare

LISTEN_S = 0.3
CONFIGURE_S = 5.0  # at most, where there is something to configure; else until all have been heard, at most:
HEAR_S = 0.5
SETTLE_S = 0.2  # after the last drive is configured, before rates are counted
OBSERVE_S = 0.5  # at least
_PERIODS = 6  # of the slowest message, at least


@dataclass
class StepReport:
    """One configuration step. answer: what the drive said, or why it was not asked."""

    object: str
    action: str
    value: int | None
    need: str
    why: str
    answer: str


@dataclass
class NodeReport:
    """One CANopen node. axis: of the rig, or empty. state: of its last heartbeat, or empty."""

    identity: NodeIdentity
    axis: str
    state: str
    boot_ups: int


@dataclass
class AxisReport:
    """One axis of the rig. drive: what the rig's files call it. phase: how far the master came; empty where the layout
    has no master. problem: why the drive cannot be used. state: of the power state machine, by the standard's name, or
    empty. status: what the drive says of itself in the terms of every layout; None where no frame could be read.
    position: m (rad).
    """

    name: str
    drive: str = ""
    node: int | None = None
    phase: str = ""
    problem: str = ""
    state: str = ""
    status: DriveStatus | None = None
    position: float | None = None
    steps: list[StepReport] = field(default_factory=list)


@dataclass
class SurveyReport:
    """intruder: the command frame that somebody else sends, or empty. nodes: of a CANopen bus. frames: what the layout
    expects beside what was heard. unknown: how many frames of each other identifier, and the last, while the rig's host
    was running. pace: its ticks took so many times their period; 0 before.
    """

    rig: str
    intruder: str = ""
    nodes: list[NodeReport] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)  # node numbers of the rig that did not answer
    emergencies: list[str] = field(default_factory=list)
    axes: list[AxisReport] = field(default_factory=list)
    frames: list[Comparison] = field(default_factory=list)
    unknown: list[tuple[int, Frame]] = field(default_factory=list)
    pace: float = 0.0
    error_frames: int = 0

    @property
    def ready(self) -> bool:
        """Every drive is configured, and sends what the rig file says."""
        return not (
            self.intruder
            or self.missing
            or any(axis.problem or axis.position is None for axis in self.axes)
            or any(frame.problem for frame in self.frames)
        )


class Survey:
    """The procedure; `step` once a tick until `done`, then `report`."""

    def __init__(self, host: DriveHost) -> None:
        self.host = host
        self.done = False
        self._period_s = host.rig.period_ns * 1e-9
        self._messages = host.protocol.messages(host.rig.period_ns)
        master = host.cia402
        plans = master.plans if master else []
        nodes = [node.node_id for node in master.nodes] if master else []
        emergency_ids = {plan.emcy_id: node for plan, node in zip(plans, nodes, strict=True) if plan.emcy_id}
        own, answers = fixed_bits(host.protocol)
        self._own = own
        self._commands = {m.can_id & own: m.name for m in self._messages if m.sender == "host"}
        known = {m.can_id & answers: m.can_id for m in self._messages}
        self.log = FrameLog(
            emergency_ids, canopen=master is not None, whose=lambda can_id: known.get(can_id & answers, can_id)
        )
        self._occasional = {*emergency_ids, *(cia301.SDO_RESPONSE_ID + node for node in nodes)}
        self._occasional |= {m.can_id for m in self._messages if (m.after or m.name).startswith(SERVICE)}
        self._nodes = nodes
        self._scan = NodeScan(MASTER_ID) if master else None
        self._report = SurveyReport(host.rig.name)
        self._phase: Callable[[int, Sequence[Frame]], list[Frame]] = self._listen
        self._left = self._ticks(LISTEN_S)
        self._observed_ns: list[int] = []  # when the ticks were in which rates are counted

    def _ticks(self, seconds: float) -> int:
        return max(1, round(seconds / self._period_s))

    def step(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        """One tick: the frames received since the last one, and those to send now."""
        self.log.add(frames)
        self._left -= 1
        return self._phase(now_ns, frames)

    def _enter(self, phase: Callable[[int, Sequence[Frame]], list[Frame]], seconds: float) -> None:
        self._phase, self._left = phase, self._ticks(seconds)

    def _listen(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        for frame in frames:
            name = self._commands.get(frame.can_id & self._own)
            if name and not frame.flags & ECHO:
                self._report.intruder = f"{name} ({frame.can_id & 0x1FFFFFFF:X}h)"
                self.done = True
                return []
        if self._left <= 0:
            if self._scan:
                self._enter(self._search, CONFIGURE_S)
            else:
                self._enter(self._configure, HEAR_S)
        return []

    def _search(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        """Who is on a CANopen bus."""
        assert self._scan is not None
        for frame in frames:
            self._scan.on_frame(frame)
        request = self._scan.service()
        if self._scan.done:
            self._enter(self._configure, max(CONFIGURE_S, self._configure_ticks() * self._period_s))
        return [] if request is None else [request]

    def _configure_ticks(self) -> int:
        """In which a slow rig's drives are configured, some requests twice."""
        master = self.host.cia402
        return 2 * SERVICE_TICKS * sum(len(plan.steps) for plan in master.plans) if master else 0

    def _configure(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        """Until every drive is configured, refused or known to be absent."""
        self.host.take(frames, now_ns)
        if self._left <= 0 or self._settled():
            self._enter(self._settle, SETTLE_S)
        return self.host.zero()

    def _settled(self) -> bool:
        master = self.host.cia402
        if master is None:
            return all(sample is not None for sample in self.host.samples)
        found = self._scan.found if self._scan else {}
        return all(node.phase in (Phase.RUNNING, Phase.REFUSED) or node.node_id not in found for node in master.nodes)

    def _settle(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        self.host.take(frames, now_ns)
        if self._left <= 0:
            self.log.clear()
            slowest_s = max(m.period_ns for m in self._messages) * 1e-9
            self._enter(self._observe, max(OBSERVE_S, _PERIODS * slowest_s))
        return self.host.zero()

    def _observe(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        self.host.take(frames, now_ns)
        self._observed_ns.append(now_ns)
        self.done = self._left <= 0
        return self.host.zero()

    # the report -------------------------------------------------------------------------------------------------------

    def report(self) -> SurveyReport:
        """All that was found; of an unfinished survey what it had come to."""
        report, log, host = self._report, self.log, self.host
        names = host.rig.axis_names
        report.emergencies, report.error_frames = log.emergencies, log.error_frames
        if self._scan:
            axis_of = dict(zip(self._nodes, names, strict=True))
            report.nodes = [
                NodeReport(identity, axis_of.get(node, ""), _heartbeat(log, node), log.boot_ups.get(node, 0))
                for node, identity in sorted(self._scan.found.items())
            ]
            report.missing = [node for node in self._nodes if node not in self._scan.found] if self._scan.done else []
        report.axes = [self._axis(axis, name) for axis, name in enumerate(names)]
        if self._phase == self._observe:
            self._compare(report)
        return report

    def _compare(self, report: SurveyReport) -> None:
        expected = [m for m in self._messages if m.sender != "host" and m.can_id not in self._occasional]
        heard, times = self.log.heard, self._observed_ns
        if len(times) > 1:
            report.pace = (times[-1] - times[0]) * 1e-9 / ((len(times) - 1) * self._period_s)
        pace = report.pace or 1.0
        report.frames = [compare(m, heard.get(m.can_id), self.host.rejects, pace) for m in expected]
        known = {m.can_id for m in self._messages} | self._occasional
        report.unknown = [(item.count, item.last) for can_id, item in sorted(heard.items()) if can_id not in known]

    def _axis(self, axis: int, name: str) -> AxisReport:
        host = self.host
        report = AxisReport(name, position=host.position(axis))
        report.status = host.status(axis) if host.samples[axis] else None
        if host.cia402:
            node, plan = host.cia402.nodes[axis], host.cia402.plans[axis]
            report.drive, report.node, report.phase = plan.name, node.node_id, node.phase.name
            report.problem = node.problem
            report.state = node.state.name if node.state else ""
            report.steps = _steps(plan, node)
        else:
            report.problem = host.problem(axis)
        return report


def _heartbeat(log: FrameLog, node: int) -> str:
    state = log.heartbeats.get(node)
    if state is None:
        return ""
    return next((s.name for s in NmtState if s == state), f"{state:#x}")


def _steps(plan: DrivePlan, node: NodeMaster) -> list[StepReport]:
    """Every planned step with the drive's answer."""
    answers = {answer.step: answer.text for answer in node.answers}
    found = []
    for planned in plan.planned:
        step = planned.step
        value = step.value if step.size or step.mask else None
        answer = f"not made: {planned.skipped}" if planned.skipped else answers.get(step, "not reached")
        action = "write" if step.size else "read"
        name = object_name(step.object_index, step.subindex)
        found.append(StepReport(name, action, value, planned.need, planned.why, answer))
    return found
