"""A drive with a protocol of its own in front of a `ServoDrive`: what ODrive, VESC and moteus share."""

from collections.abc import Callable

from drivers.frame import Frame
from drivers.protocols.base import Sample
from sim_plant.drives.servo import NEVER_NS, ServoDrive

_PHASE_NS = 137_000  # by which a node's first frame is later than that of the node before: nobody synchronises them

Periodic = tuple[int, Callable[[], Frame]]  # (period in ns, what is sent)


class CyclicNode:
    """One drive. A kind of drive says what it does with a frame (`receive`) and in time (`live`).

    periodic: what it sends in its own time; nothing where it answers only. now_ns: time reached. sampled_ns: when it
    last sampled its encoder for a frame (the first of `periodic`). next_ns: when it has something to send. fd: it
    speaks CAN FD.
    """

    fd = False

    def __init__(self, node_id: int, servo: ServoDrive, start_ns: int, *periodic: Periodic) -> None:
        self.node_id = node_id
        self.servo = servo
        self.now_ns = start_ns
        self.sampled_ns = -NEVER_NS
        first_ns = start_ns + _PHASE_NS * (servo.axis + 1)
        self._periodic = [[first_ns, period_ns] for period_ns, _ in periodic]
        self._make = [make for _, make in periodic]
        self.next_ns = first_ns if periodic else NEVER_NS

    def on_frame(self, frame: Frame) -> list[Frame]:
        """What it sends at the reception of a frame; whatever fell due before comes first. Never raises."""
        due = self.advance(frame.timestamp_ns)
        return due + self.receive(frame)

    def advance(self, now_ns: int) -> list[Frame]:
        """Let time pass to now_ns: what it sends in its own time. A period missed is not made up for."""
        self.now_ns = max(now_ns, self.now_ns)
        self.live()
        frames = []
        for number, entry in enumerate(self._periodic):
            due_ns, period_ns = entry
            if self.now_ns < due_ns:
                continue
            entry[0] = due_ns + (1 + (self.now_ns - due_ns) // period_ns) * period_ns
            frames.append(self._make[number]())
            if number == 0:
                self.sampled_ns = self.now_ns
        if frames:
            self.next_ns = min(due_ns for due_ns, _ in self._periodic)
        return frames

    def receive(self, frame: Frame) -> list[Frame]:
        """What it answers to a frame."""
        raise NotImplementedError

    def live(self) -> None:
        """Time has passed to now_ns."""

    def feed(self) -> None:
        """The host is there: its watchdog begins anew."""
        self.servo.last_command_ns = self.now_ns
        self.servo.deadline_ns = self.now_ns + self.servo.watchdog_ns

    def unlatch(self) -> None:
        """End what the servo has latched; it stays without torque."""
        deadline_ns = self.servo.deadline_ns
        for reset in (False, True):  # it wants to see its reset bit clear first
            self.servo.on_command(0.0, False, reset, 0, self.now_ns)
        self.servo.deadline_ns = deadline_ns

    def shown(self) -> Sample:
        """The servo's state as faults injected into it let it be seen."""
        return self.servo.sample(0.0, self.now_ns)
