"""Homing on the encoder's index by a bought drive's touch probe: found to the count, or a fault within the way."""

import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.families.cia402.errand import ANSWER_TICKS, MOST_ASKED, PATIENCE_TICKS, Errand, written
from drivers.families.cia402.host import Cia402Host
from drivers.families.cia402.sdo import Step
from drivers.families.cia402.touch_probe import TPDO3_ID
from drivers.protocols.base import LayoutError
from hil.cycle.axis_homing import Step as Sub
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.bought_drives import EDS, cia402
from tests.support.foreign_drive import CST_DRIVE, I32, U16, Fact, _pdo, eds_text
from tests.support.homing import FARTHEST, PLACE, START, ZERO, Homed, home_once

COUNT = 1e-7  # m
PROBE = {(0x60B8, 0): Fact(U16), (0x60B9, 0): Fact(U16, "ro", "0", True), (0x60BA, 0): Fact(I32, "ro", "0", True)}
UNMAPPED = PROBE | {(0x60BA, 0): Fact(I32, "ro")}
TPDO3 = _pdo(0x1802, "$NODEID+0x80000380")
SPEED = 0.1  # m/s: a thousand counts from one sample to the next


def rig_of(
    folder: Path, facts: dict[tuple[int, int], Fact] | None = None, *, told: bool = True, index: float | None = PLACE,
    start: float = START, zero: float = ZERO, mounted: int = 1, contact: str = "sound", towards: int = -1,
    tells: Sequence[str] = (), **drive: Any,
) -> RigConfig:  # fmt: skip
    """The paper's stage on CST drives with a touch probe, whose X axis homes on its encoder's index."""
    facts = CST_DRIVE | (TPDO3 | PROBE if facts is None else facts)
    (folder / EDS).write_text(eds_text(facts))
    document = cia402()
    document["bus"]["cia402"]["touch_probe"] = told
    home = {"by": "index", "farthest": FARTHEST, "speed": SPEED, "at": PLACE, "direction": towards}
    document["axes"]["x"] |= {"home": home, "direction": mounted, "must_tell": list(tells)}
    for axis in document["axes"].values():
        del axis["push"]
    switches = {"axis": "x", "zero": zero, "contact": contact} | ({} if index is None else {"index": index})
    document["plant"] |= {"switches": [switches], "initial_position": [start, 0.0]}
    document["plant"]["drive"] |= drive
    return RigConfig.model_validate(document)


def homed_on(rig: RigConfig, folder: Path, tampered: Callable[[LockstepRun], None] | None = None) -> Homed:
    run, homed = home_once(rig, folder, tampered=tampered)
    for _ in range(20):
        run.tick()
    if homed.fault is not Fault.NONE:
        assert not any(servo.force for servo in run.stage.drives), "no torque is left"
    return homed


@pytest.mark.parametrize(("facts", "told"), [(None, True), (None, False), (UNMAPPED | TPDO3, True), (PROBE, True)])
def test_the_index_is_found_to_the_count(facts: dict[tuple[int, int], Fact] | None, told: bool, tmp_path: Path) -> None:
    homed = homed_on(rig_of(tmp_path, facts, told=told), tmp_path)
    assert (homed.state, homed.fault, homed.known) == (State.READY, Fault.NONE, True), homed.why
    assert homed.steps == [Sub.SEARCH, Sub.MOVE_TO]
    assert abs(homed.off) <= COUNT
    mapped = facts is None and told
    assert homed.way < abs(START - PLACE) + 5e-3 if mapped else homed.way == pytest.approx(0.95 * FARTHEST, rel=0.01)


@pytest.mark.long
def test_it_repeats_within_a_count_from_wherever_the_axis_begins(tmp_path: Path) -> None:
    draw, offs = random.Random(60), []
    for _ in range(6):
        start, zero = PLACE + draw.uniform(1e-3, 0.02), draw.uniform(-0.05, 0.05)
        homed = homed_on(rig_of(tmp_path, start=start, zero=round(zero / COUNT) * COUNT), tmp_path)
        assert homed.known, homed.why
        offs.append(homed.off)
    assert np.ptp(offs) <= 1.001 * COUNT


@pytest.mark.parametrize("towards", [1, -1])
def test_a_drive_that_is_mounted_backwards_latches_in_its_own_counts(towards: int, tmp_path: Path) -> None:
    """[[plant.switches]] are in the drive's terms: its index and zero are on the other side there."""
    start, drive = PLACE - towards * 0.01, {"index": -PLACE, "zero": -ZERO}
    homed = homed_on(rig_of(tmp_path, mounted=-1, start=start, towards=towards, **drive), tmp_path)
    assert homed.known, homed.why
    assert abs(homed.off - 2.0 * ZERO) <= 1.001 * COUNT


@pytest.mark.long
def test_what_was_latched_before_the_search_counts_no_more(tmp_path: Path) -> None:
    """A second homing, with the index elsewhere meanwhile, finds where it is now."""
    rig = rig_of(tmp_path)
    run, homed = home_once(rig, tmp_path)
    node: Any = run.stage._nodes[0]
    assert homed.known
    assert node.dictionary.number(0x60B8 << 8) == 0, "switched off after homing"
    node._probe.index -= 250_000.0
    _, again = home_once(rig, tmp_path, run=run)
    assert again.known, again.why
    assert again.off - homed.off == pytest.approx(250_000 * COUNT, abs=1.001 * COUNT)


# failures -------------------------------------------------------------------------------------------------------------


@pytest.mark.requirement(id="SR-4.5")
@pytest.mark.parametrize(
    "broken",
    [
        {"index": None},
        {"contact": "dead"},
        {"contact": "stuck"},
        {"towards": 1},
        {"index": START - 0.96 * FARTHEST},
    ],
    ids=["absent", "dead", "stuck", "wrong direction", "too far"],
)
@pytest.mark.parametrize("told", [True, False])
def test_an_index_that_does_not_come_is_a_fault_within_the_way_allowed(
    broken: dict[str, Any], told: bool, tmp_path: Path
) -> None:
    homed = homed_on(rig_of(tmp_path, told=told, **broken), tmp_path)
    assert (homed.state, homed.fault, homed.known) == (State.FAULT, Fault.HOMING_FAILED, False)
    assert "not found within home.farthest" in homed.why
    assert homed.way <= FARTHEST


@pytest.mark.parametrize(
    "drive",
    [{"aborts": ["60B8h"]}, {"instead": {"60B8h": 0}}, {"instead": {"60B9h": 2}}, {"instead": {"60B9h": 0}}],
    ids=["refuses", "does not keep it", "always latched", "never on"],
)
def test_a_drive_that_does_not_take_it_moves_nothing(drive: dict[str, Any], tmp_path: Path) -> None:
    homed = homed_on(rig_of(tmp_path, **drive), tmp_path)
    assert (homed.fault, homed.known) == (Fault.HOMING_FAILED, False)
    assert "its drive refuses what it is told to find it with, or does not answer" in homed.why
    assert homed.way < 1e-5


@pytest.mark.parametrize(("search", "way"), [(False, 1e-5), (True, FARTHEST)])
def test_answers_that_are_lost_are_a_fault(search: bool, way: float, tmp_path: Path) -> None:
    """search: they are lost from the search on, where only the question at rest is left."""

    def mute(run: LockstepRun) -> None:
        node: Any = run.stage._nodes[0]
        moving = abs(run.true_position[0] - START) > 1e-3
        if moving or not search:
            node._answer = lambda _: None

    homed = homed_on(rig_of(tmp_path, told=False), tmp_path, mute)
    assert (homed.fault, homed.known) == (Fault.HOMING_FAILED, False)
    assert "does not answer" in homed.why
    assert homed.way <= way


def test_an_encoder_that_falls_silent_on_the_way_is_a_fault_and_no_place(tmp_path: Path) -> None:
    def silent(run: LockstepRun) -> None:
        if run.true_position[0] < START - 5e-3:
            run.stage._nodes[0]._tpdos[0].can_id = -1  # type: ignore[attr-defined]

    homed = homed_on(rig_of(tmp_path), tmp_path, silent)
    assert homed.fault in (Fault.ENCODER_LOST, Fault.ENCODER_DEAD)
    assert not homed.known


# the rig --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ({}, "60B8h is not in the EDS, or read-only: its drive has no touch probe"),
        (PROBE | {(0x60B8, 0): Fact(U16, "ro")}, "60B8h is not in the EDS, or read-only"),
        ({(0x60B8, 0): Fact(U16)}, "60B9h or 60BAh is not in the EDS"),
    ],
)
def test_a_drive_without_one_is_refused(facts: dict[tuple[int, int], Fact], says: str, tmp_path: Path) -> None:
    with pytest.raises(LayoutError) as refused:
        host_layout(rig_of(tmp_path, facts), tmp_path)
    assert f'axes.x.home.by = "index": {says}' in str(refused.value)


def test_a_bought_drive_says_no_homed_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match="its answers have no bit for HOMED"):
        host_layout(rig_of(tmp_path, tells=["homed"]), tmp_path)


def test_probes_are_told_at_every_tenth_sync_where_that_is_asked(tmp_path: Path) -> None:
    told = host_layout(rig_of(tmp_path), tmp_path).messages(1_000_000)
    probes = [(m.can_id, m.length, m.period_ns) for m in told if m.name.startswith("probe")]
    assert probes == [(TPDO3_ID + 3, 6, 10_000_000), (TPDO3_ID + 9, 6, 10_000_000)]
    unasked = host_layout(rig_of(tmp_path, told=False), tmp_path).messages(1_000_000)
    assert len(unasked) == len(told) - 2


def test_a_probe_that_cannot_be_mapped_is_told(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, UNMAPPED | TPDO3)
    layout: Any = host_layout(rig, tmp_path)
    host: Cia402Host = getattr(layout, "layout", layout)
    assert any("cannot be mapped into TPDO 3" in text for text in host.warnings)


# errands --------------------------------------------------------------------------------------------------------------


def answered(request: bytes, value: int = 0) -> bytes:
    """What a drive answers to a write, or to a read of two bytes."""
    command = 0x60 if request[0] >> 5 == 1 else 0x4B
    return bytes((command, *request[1:4])) + value.to_bytes(4, "little")


def test_an_errand_writes_reads_back_and_is_over() -> None:
    errand = Errand(written(0x60B8, 0, 0x15, 2))
    assert errand.on_answer(answered(errand.request(1)))
    assert not errand.over
    assert errand.on_answer(answered(errand.request(2), 0x15))
    assert (errand.over, errand.problem, errand.values) == (True, "", {0x60B8: 0x15})
    assert errand.request(3) == b""
    assert Errand([]).over


def test_a_request_without_an_answer_is_made_so_often_and_no_more() -> None:
    errand, sent = Errand([Step(0x60B9, 0, 0)]), []
    for tick in range(MOST_ASKED * (ANSWER_TICKS + 2) + 10):
        if request := errand.request(tick):
            sent.append(request[0])
    assert sent == [0x40, 0x80] * MOST_ASKED
    assert errand.problem == "no answer to 60B9h:00"


def test_a_read_waits_for_what_is_expected_but_not_for_ever() -> None:
    errand, tick = Errand([Step(0x60B9, 0, 1, mask=1)]), 0
    while not errand.over:
        tick += 1
        if request := errand.request(tick):
            errand.on_answer(answered(request, 2))
    assert tick == pytest.approx(PATIENCE_TICKS, abs=3)
    assert errand.problem == "60B9h = 0x2; expected 0x1 in the bits 0x1"


def test_answers_of_others_are_not_its_own() -> None:
    errand = Errand([Step(0x60B9, 0, 0)])
    assert not errand.on_answer(answered(b"\x40\xb9\x60\x00")), "nothing is open"
    errand.request(1)
    assert not errand.on_answer(answered(b"\x40\x41\x60\x00"))
    assert not errand.over
    errand.fail("node 3 is configured anew")
    assert (errand.over, errand.problem) == (True, "node 3 is configured anew")
