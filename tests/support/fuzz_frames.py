"""Random and mutated frames against every layout, both ends, and the emulated CANopen drives.

A lane of its own for 10^7 frames: .venv/bin/python -m tests.support.fuzz_frames 10000000.
tests/drivers/protocols/test_fuzz_frames.py runs 10^5.
"""

import math
import sys
import tomllib
from collections.abc import Callable
from dataclasses import astuple
from random import Random
from zlib import crc32

from drivers.config import BusConfig
from drivers.frame import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import EVERY_STATUS, Command, Reject, Sample
from drivers.protocols.checksum import AUTOSAR_POLYNOMIAL, SAE_J1850_POLYNOMIAL, crc8, crc8_table
from hil.cycle.inbox import Inbox
from sim_plant.config import PlantConfig
from sim_plant.emulator import EmulatedStage
from tests.support.paths import RIGS

PROTOCOLS = ("stage_fd", "stage_classic", "cia402", "dbc:example_drive.dbc")
RATED = [5.0, 5.0]
PERIOD_NS = 1_000_000
PER_TICK = 16  # frames


class CheckedHost:
    """A HostProtocol whose every outcome is checked and counted, between the bytes and the inbox."""

    def __init__(self, bus: BusConfig) -> None:
        self.inner = host_protocol(bus, 2, RATED, RIGS)
        self.name, self.n_axes, self.fd = self.inner.name, self.inner.n_axes, self.inner.fd
        self.sequence_modulus, self.checksum = self.inner.sequence_modulus, self.inner.checksum
        self.encode, self.messages = self.inner.encode, self.inner.messages
        self.samples = 0
        self.rejects = dict.fromkeys(Reject, 0)

    def decode(self, frame: Frame) -> Sample | Reject:
        """The inner outcome; AssertionError for one that the estimator must never see."""
        outcome = self.inner.decode(frame)
        if isinstance(outcome, Reject):
            self.rejects[outcome] += 1
            return outcome
        axis, position, status, sequence, stamp = astuple(outcome)
        assert type(axis) is type(position) is type(status) is type(sequence) is type(stamp) is int, (frame, outcome)
        assert 0 <= axis < self.n_axes, (frame, outcome)
        assert -(2**53) <= position <= 2**53, (frame, outcome)
        assert 0 <= status <= EVERY_STATUS, (frame, outcome)
        assert -1 <= sequence < max(self.sequence_modulus, 1), (frame, outcome)
        assert abs(stamp - frame.timestamp_ns) <= 2**31, (frame, outcome)
        self.samples += 1
        return outcome


def check_command(outcome: Command | Reject, frame: Frame) -> None:
    """AssertionError for a command that no drive may obey."""
    if isinstance(outcome, Command):
        assert len(outcome.force) == 2, frame
        assert all(math.isfinite(f) and abs(f) <= r * 1.000001 for f, r in zip(outcome.force, RATED, strict=True)), (
            frame
        )
        assert 0 <= outcome.enable < 4, frame


_AUTOSAR, _SAE = crc8_table(AUTOSAR_POLYNOMIAL), crc8_table(SAE_J1850_POLYNOMIAL)


def repair(protocol: str, frame: Frame) -> Frame:
    """The frame with the checksum that its layout wants: damage that no checksum finds."""
    data = frame.data
    if protocol == "stage_fd":
        return frame._replace(data=data[:-4] + crc32(data[:-4], frame.can_id).to_bytes(4, "little"))
    if protocol == "stage_classic":
        identifier = (frame.can_id & 0x7FF).to_bytes(2, "little")
        return frame._replace(data=data[:-1] + bytes((crc8(identifier + data[:-1], _AUTOSAR),)))
    return frame._replace(data=data[:-1] + bytes((crc8(data[:-1], _SAE),)))


class Mutator:
    """Makes a frame out of one that was on the bus, or out of nothing."""

    def __init__(self, protocol: str, seed: int) -> None:
        self._random = Random(seed)
        self._protocol = protocol
        self.corpus: list[Frame] = [Frame(0, b"")]
        self._ways: list[Callable[[Frame], Frame]] = [
            lambda frame: frame,
            self._flip,
            self._flip,
            self._resize,
            self._other_id,
            self._other_kind,
            self._other_flags,
            self._other_payload,
            lambda _: self._anything(),
            lambda frame: repair(self._protocol, self._flip(frame)),
            lambda frame: repair(self._protocol, self._other_payload(frame)),
        ]

    def keep(self, frame: Frame) -> None:
        """Remember a frame to mutate; the newest 256 are kept."""
        if len(self.corpus) >= 256:
            self.corpus[self._random.randrange(256)] = frame
        else:
            self.corpus.append(frame)

    def frame(self, now_ns: int) -> Frame:
        """The next frame."""
        pick = self._random.random
        way = self._ways[int(pick() * len(self._ways))]
        return way(self.corpus[int(pick() * len(self.corpus))])._replace(timestamp_ns=now_ns)

    def _flip(self, frame: Frame) -> Frame:
        if not frame.data:
            return frame
        data = bytearray(frame.data)
        for _ in range(self._random.randint(1, 3)):
            bit = self._random.randrange(8 * len(data))
            data[bit // 8] ^= 1 << bit % 8
        return frame._replace(data=bytes(data))

    def _resize(self, frame: Frame) -> Frame:
        length = self._random.choice(FD_LENGTHS if frame.flags & FD else FD_LENGTHS[:9])
        return frame._replace(data=frame.data[:length].ljust(length, b"\xa5"))

    def _other_id(self, frame: Frame) -> Frame:
        if self._random.random() < 0.5:
            return frame._replace(can_id=frame.can_id ^ 1 << self._random.randrange(11))
        return frame._replace(can_id=self._random.choice(self.corpus).can_id)

    def _other_kind(self, frame: Frame) -> Frame:
        return frame._replace(can_id=frame.can_id | self._random.choice((EXTENDED, REMOTE, ERROR, EXTENDED | REMOTE)))

    def _other_flags(self, frame: Frame) -> Frame:
        return frame._replace(flags=self._random.choice((0, BRS, ESI, FD, FD | BRS, FD | ESI)))

    def _other_payload(self, frame: Frame) -> Frame:
        return frame._replace(data=self._random.randbytes(len(frame.data)))

    def _anything(self) -> Frame:
        length = self._random.choice(FD_LENGTHS)
        flags = FD if length > 8 else self._random.choice((0, FD | BRS))
        return Frame(self._random.getrandbits(self._random.choice((11, 32))), self._random.randbytes(length), flags)


def bus_of(protocol: str) -> BusConfig:
    """[bus] of the fuzzed rig."""
    if protocol.startswith("dbc:"):
        return BusConfig.model_validate(tomllib.loads((RIGS / "paper-dbc.toml").read_text())["bus"])
    return BusConfig(protocol=protocol)


def fuzz(protocol: str, count: int, seed: int) -> dict[str, int]:
    """Give `count` frames to host, device and emulated stage. Returns outcomes by name; any failure raises.

    Host and stage also talk to each other, so that the mutations start from frames of every phase of a run.
    """
    bus = bus_of(protocol)
    host, device = CheckedHost(bus), device_protocol(bus, 2, RATED, RIGS)
    inbox = Inbox(host, leak_ticks=100)
    plant = PlantConfig(mass=[0.02, 0.01], coulomb=[1.0, 0.1], viscous=[0.0, 0.0], quadratic=[0.0, 0.0])
    stage = EmulatedStage(plant, bus, ["x", "y"], RATED, RIGS)
    mutator, given, refused_twice = Mutator(protocol, seed), 0, 0
    true_frames: list[Frame] = []
    for tick in range(-(-count // PER_TICK)):
        now_ns = (tick + 1) * PERIOD_NS
        noise = [mutator.frame(now_ns) for _ in range(min(PER_TICK, count - given))]
        given += len(noise)
        before = sum(inbox.rejects)
        inbox.collect([*true_frames, *noise], tick - 1)
        refused_twice += sum(inbox.rejects) - before
        for frame in noise:
            check_command(device.decode_command(frame), frame)
            stage.on_frame(frame)
            assert all(math.isfinite(f) and abs(f) <= 5.00001 for f in stage.applied_force), frame
        enable = 3 if tick % 100 > 50 else 0
        sent = host.encode(Command(tick, [0.1 * (enable > 0), 0.0], enable, tick % 100 == 0))
        true_frames = []
        for frame in sent:
            mutator.keep(frame)
            for answer in stage.on_frame(frame._replace(timestamp_ns=now_ns + 300_000)):
                true_frames.append(answer._replace(timestamp_ns=now_ns + 400_000))
                mutator.keep(answer)
    judged = inbox.rejects[Reject.STALE] + inbox.rejects[Reject.DUPLICATE]
    refused = sum(host.rejects.values())
    assert sum(inbox.rejects) == refused + judged == refused_twice  # each under one reason, none twice
    for reason, number in host.rejects.items():
        assert inbox.rejects[reason] == number or reason in (Reject.STALE, Reject.DUPLICATE)
    outcomes = {reason.name: number for reason, number in zip(Reject, inbox.rejects, strict=True)}
    return {"frames": given, "samples": host.samples, **outcomes}


def main() -> None:
    """Run the lane: python -m tests.support.fuzz_frames [frames [seed]]."""
    total = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    batch = 250_000
    share = -(-total // len(PROTOCOLS))
    for protocol in PROTOCOLS:
        sums: dict[str, int] = {}
        for number, start in enumerate(range(0, share, batch)):
            outcome = fuzz(protocol, min(batch, share - start), seed * 1_000_003 + number)
            sums = {key: sums.get(key, 0) + value for key, value in outcome.items()}
            print(f"\r{protocol}: {sums['frames']} of {share}", end="", flush=True)
        print(f"\r{protocol}: {sums}")


if __name__ == "__main__":
    main()
