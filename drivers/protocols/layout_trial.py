"""Whether the two sides of a user's frame layout understand each other: tried before anything is opened.

One side sends, the other reads, as on a bus without losses. Torques within the resolution that is stated, permissions,
positions, states and sequence numbers have to arrive; bytes that mean nothing must raise nothing. What both sides get
wrong alike it cannot see: for that there are drives made from another document ([plant.drive]), and the real ones.
"""

from collections.abc import Iterator
from random import Random

from drivers.frame import EXTENDED, FD, FD_LENGTHS, Frame
from drivers.protocols.base import UNHEALTHY, Command, DriveStatus, LayoutError, Sample
from drivers.protocols.user_sides import Maker, UserDrives, UserHost

ROUNDS = 40  # ticks, of which a layout may need some to start up
NOISE = 200  # frames
FORCES = (0.0, 0.5, -1.0, 1.0, -0.013)  # of the rated one
POSITIONS = (0, 3, 700, -5, -300)  # counts; near each other, for positions that are of one turn alone
STATES = (
    DriveStatus.HOMED,
    DriveStatus.HOMED | DriveStatus.ENABLED,
    DriveStatus.HOMED | DriveStatus.FAULT,
    DriveStatus.HOMED | DriveStatus.WATCHDOG,
    DriveStatus.ENCODER_FAULT,
)
ANSWER_NS = 300_000  # after the tick's start


def try_sides(host: UserHost, drives: UserDrives, maker: Maker) -> None:
    """Raises LayoutError that says which side made what of what the other said."""
    _check_messages(host, maker)
    read = 0
    for tick, command in enumerate(_commands(host, drives, maker)):
        now_ns = (tick + 1) * maker.wiring.period_ns
        frames = host.encode(command)
        _raise_problems(host)
        if any(frame.flags & FD for frame in frames) and not host.fd:
            raise LayoutError(maker.told("host().encode", "sends a CAN FD frame, and fd is False"))
        understood = [drives.decode_command(frame._replace(timestamp_ns=now_ns)) for frame in frames]
        whole = [each for each in understood if isinstance(each, Command)]
        if not whole:
            continue
        read += 1
        _compare_commands(command, whole[-1], host, drives, maker)
        for axis in range(host.n_axes):
            _compare_samples(_sample(axis, tick, whole[-1].sequence, now_ns), now_ns, host, drives, maker)
    if not read:
        raise LayoutError(
            maker.told("drives().decode_command", f"reads no command in what host() sends in {ROUNDS} ticks")
        )
    for frame in _noise(host):
        host.decode(frame)
        _raise_problems(host)
        drives.decode_command(frame)


def _raise_problems(host: UserHost) -> None:
    if host.own_problems:
        raise LayoutError(host.own_problems[0])


def _check_messages(host: UserHost, maker: Maker) -> None:
    messages = host.messages(maker.wiring.period_ns)
    senders = {message.sender for message in messages}
    for sender in ("host", *(f"axis {axis}" for axis in range(host.n_axes))):
        if sender not in senders:
            raise LayoutError(maker.told("host().messages", f"nothing in its list is sent by {sender!r}"))
    if host.echo_id is not None and host.echo_id not in {message.can_id for message in messages}:
        raise LayoutError(maker.told("host()", f"echo_id = {host.echo_id:#x} is no message of its own"))


def _commands(host: UserHost, drives: UserDrives, maker: Maker) -> Iterator[Command]:
    """What the control cycle may say: none enabled, all, one; each for as long as the layout takes to say so."""
    rated, n = maker.wiring.rated_force, host.n_axes
    lasts = drives.enable_lag + 1
    for tick in range(ROUNDS * lasts):
        number = tick // lasts
        enable = ((1 << n) - 1, 1 << number // 3 % n, 0)[number % 3] if number else 0
        share = FORCES[number % len(FORCES)]
        force = [share * rated[axis] * (-1) ** axis if enable >> axis & 1 else 0.0 for axis in range(n)]
        yield Command(tick, force, enable, reset=number == 4)


def _compare_commands(sent: Command, read: Command, host: UserHost, drives: UserDrives, maker: Maker) -> None:
    what = "drives().decode_command"
    for axis, (said, heard) in enumerate(zip(sent.force, read.force, strict=True)):
        step = maker.wiring.rated_force[axis] * (drives.force_resolution + 1e-6)
        if not abs(heard - said) <= step:
            raise LayoutError(
                maker.told(what, f"host() sends {said:g} to axis {axis}, and {heard:g} is read; force_resolution = "
                           f"{drives.force_resolution:g} allows {step:g}")
            )  # fmt: skip
    if host.states and sent.sequence % (drives.enable_lag + 1) == drives.enable_lag and read.enable != sent.enable:
        raise LayoutError(maker.told(what, f"host() enables axes {sent.enable:#b}, and {read.enable:#b} is read"))
    if host.sequence_modulus and (read.sequence - sent.sequence) % host.sequence_modulus:
        raise LayoutError(maker.told(what, f"host() sends sequence {sent.sequence}, and {read.sequence} is read"))


def _sample(axis: int, tick: int, sequence: int, now_ns: int) -> Sample:
    position = POSITIONS[(tick + axis) % len(POSITIONS)]
    return Sample(axis, position, int(STATES[(tick + axis) % len(STATES)]), sequence, now_ns)


def _compare_samples(sent: Sample, now_ns: int, host: UserHost, drives: UserDrives, maker: Maker) -> None:
    what = "host().decode"
    told: list[Sample] = []
    for frame in drives.frames_of(sent):
        outcome = host.decode(frame._replace(timestamp_ns=now_ns + ANSWER_NS))
        _raise_problems(host)
        told += [outcome] if isinstance(outcome, Sample) else outcome if isinstance(outcome, tuple) else []
    own = [sample for sample in told if sample.axis == sent.axis]
    if not own:
        raise LayoutError(maker.told(what, f"makes no sample of what the drive of axis {sent.axis} answers"))
    heard = own[-1]
    told_of = int(UNHEALTHY | DriveStatus.ENABLED) if host.causes else int(DriveStatus.ENABLED)
    pairs = [("position", sent.position, heard.position)]
    if host.sequence_modulus:
        pairs.append(("sequence", sent.sequence % host.sequence_modulus, heard.sequence))
    if host.states and not host.state_ns:
        pairs.append(("status", sent.status & told_of, heard.status & told_of))
        pairs.append(("health", bool(sent.status & UNHEALTHY), bool(heard.status & UNHEALTHY)))
    for name, said, read in pairs:
        if said != read:
            raise LayoutError(maker.told(what, f"the drive of axis {sent.axis} says {name} {said}, and {read} is read"))


def _noise(host: UserHost) -> Iterator[Frame]:
    """Bytes that mean nothing, on identifiers of the layout and on others; the same every time."""
    random = Random(1)
    known = [message.can_id for message in host.messages(1_000_000)]
    for number in range(NOISE):
        fd = bool(number % 3 == 0)
        can_id = random.choice([*known, random.getrandbits(11), EXTENDED | random.getrandbits(29)])
        length = random.choice(FD_LENGTHS if fd else FD_LENGTHS[:9])
        yield Frame(can_id, random.randbytes(length), FD if fd else 0, timestamp_ns=1_000_000_000 + number)
