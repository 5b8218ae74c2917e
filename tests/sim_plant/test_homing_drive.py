"""The emulated drive's own homing by CiA 402-2: what its statusword says, and what it refuses."""

from pathlib import Path
from typing import Any

import pytest

from drivers.families.cia402.cia301 import DriveState, NmtState
from sim_plant.drives.homing_drive import HomingDrive, Phase
from sim_plant.drives.object_dictionary import SdoAbort, key_of
from sim_plant.drives.servo import Counter, ServoDrive, Switches
from tests.support.foreign_drive import CST_DRIVE, I8, I32, U8, U16, U32, Fact, eds_text

COUNT, MASS, STEP_S = 1e-6, 1.0, 2e-4  # m, kg, s
FACTS = CST_DRIVE | {
    (0x6072, 0): Fact(U16, "rw", "1000"),
    (0x607C, 0): Fact(I32),
    (0x6098, 0): Fact(I8),
    (0x6099, 0): Fact(U8, "ro", "2"),
    (0x6099, 1): Fact(U32, "rw", "20000"),
    (0x6099, 2): Fact(U32, "rw", "5000"),
    (0x609A, 0): Fact(U32, "rw", "1000000"),
    (0x60FD, 0): Fact(U32, "ro"),
}
BEGIN = 0x1F  # controlword: enabled, bit 4


class Bench:
    """A drive that moves a mass without friction. most: the greatest force it has applied, N."""

    def __init__(self, folder: Path, facts: Any = FACTS, *, place: float = 0.0) -> None:
        (folder / "made.eds").write_text(eds_text(facts))
        self.place, self.speed, self.most = place, 0.0, 0.0
        servo = ServoDrive(0, 5.0, COUNT, 10**12, False, 0)
        servo.counter, servo.switches = Counter(0.0, -0.01), Switches(low=-0.02, high=0.02)
        self.drive = HomingDrive(3, servo, lambda: self.place, eds=folder / "made.eds")
        self.drive.advance(0)
        self.drive.nmt = NmtState.OPERATIONAL
        self.now_ns = 0

    def write(self, index: int, value: int, size: int, subindex: int = 0) -> None:
        self.drive.dictionary.write(index, subindex, value.to_bytes(size, "little", signed=value < 0))

    def enable(self, method: int) -> None:
        self.write(0x6098, method, 1)
        self.write(0x6060, 6, 1)
        for word in (0x06, 0x07, 0x0F):
            self.write(0x6040, word, 2)
        assert self.drive.state is DriveState.OPERATION_ENABLED

    def word(self) -> int:
        """Bits 10, 12 and 13."""
        number = int.from_bytes(self.drive.dictionary.read(0x6041, 0), "little")
        return number & (1 << 10 | 1 << 12 | 1 << 13)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.speed += self.drive.servo.force / MASS * STEP_S
            self.place += self.speed * STEP_S
            self.now_ns += round(STEP_S * 1e9)
            self.drive.advance(self.now_ns)
            self.most = max(self.most, abs(self.drive.servo.force))


@pytest.mark.parametrize(("method", "home"), [(17, -0.02), (18, 0.02), (33, -0.01), (35, 0.004), (37, 0.004)])
def test_it_finds_what_its_method_says_and_counts_from_there(method: int, home: float, tmp_path: Path) -> None:
    bench = Bench(tmp_path, place=0.004)
    bench.enable(method)
    bench.run(0.05)
    assert bench.word() == 1 << 10, "not begun"
    bench.write(0x6040, BEGIN, 2)
    if method in (17, 18, 33):
        bench.run(0.1)
        assert bench.word() == 0, "under way"
    bench.run(8.0)
    assert bench.word() == 1 << 10 | 1 << 12
    counts = int.from_bytes(bench.drive.dictionary.read(0x6064, 0), "little", signed=True)
    assert counts * COUNT == pytest.approx(bench.place - home, abs=5e-6)
    assert abs(bench.speed) < 1e-3


def test_the_offset_is_what_it_counts_at_home(tmp_path: Path) -> None:
    bench = Bench(tmp_path, place=0.004)
    bench.write(0x607C, -700, 4)
    bench.enable(37)
    bench.write(0x6040, BEGIN, 2)
    bench.run(0.1)
    assert int.from_bytes(bench.drive.dictionary.read(0x6064, 0), "little", signed=True) == pytest.approx(-700, abs=5)


def test_a_method_that_it_has_not_is_its_error_and_moves_nothing(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.enable(1)
    bench.write(0x6040, BEGIN, 2)
    bench.run(0.2)
    assert bench.word() == 1 << 10 | 1 << 13
    assert abs(bench.place) < 1e-5


def test_its_torque_stays_within_6072h_and_a_lag_is_its_error(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.write(0x6072, 100, 2)
    bench.enable(17)
    bench.write(0x6040, BEGIN, 2)
    bench.run(0.05)
    held = bench.place
    for _ in range(2000):  # something holds it
        bench.run(STEP_S)
        bench.place, bench.speed = held, 0.0
    assert bench.most <= 0.1 * 5.0 * 1.001
    assert bench.drive.phase is Phase.FAILED
    assert bench.word() == 1 << 10 | 1 << 13


def test_bit_4_taken_back_ends_it(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.enable(17)
    bench.write(0x6040, BEGIN, 2)
    bench.run(0.1)
    bench.write(0x6040, 0x0F, 2)
    bench.run(1.0)
    assert bench.word() == 1 << 10
    assert abs(bench.speed) < 1e-3


@pytest.mark.parametrize("without", [{(0x6502, 0): Fact(U32, "ro", "0x205")}, {(0x6098, 0): None}])
def test_a_drive_that_does_not_offer_it_refuses_the_mode(without: dict[Any, Any], tmp_path: Path) -> None:
    facts = {place: fact for place, fact in (FACTS | without).items() if fact is not None}
    bench = Bench(tmp_path, facts)
    with pytest.raises(SdoAbort):
        bench.write(0x6060, 6, 1)
    assert bench.drive.dictionary.number(key_of(0x6060)) != 6
