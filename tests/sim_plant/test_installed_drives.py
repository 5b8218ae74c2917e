"""What a [plant.drive] table says becomes the drives that are installed, in their own units; what it cannot say."""

import math
import re
import time
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from drivers.bus.port import open_port
from drivers.config import BusConfig
from drivers.frame import EXTENDED, Frame
from drivers.protocols.base import Command
from drivers.protocols.mounting import Mounting
from hil.rig.bus_load import rig_layout
from hil.rig.file import load_rig
from hil.virtual.emulate import emulated_stage
from sim_plant.config import EmulatedDriveConfig
from sim_plant.drives.installed import installed_drives, installed_mountings
from sim_plant.drives.moteus import Moteus
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.odrive_homing import HomingOdrive
from sim_plant.drives.quirks import NO_QUIRKS, Quirks, stated_quirks
from sim_plant.drives.servo import ServoDrive
from sim_plant.drives.vesc import Vesc
from tests.support.paths import RIGS

MS = 1_000_000
DBC = BusConfig(protocol="dbc:any.dbc")
TURNS = {"turn": [0.01, -0.02]}
OF_KIND: dict[str, dict[str, Any]] = {
    "cia402": {
        "missing": ["1017h"], "aborts": ["6072h"], "answer_delay_s": 0.1, "enable_delay_s": 0.1,
        "dummy_mapping": False, "status_bits": 0x100, "answers": "block",
    },
    "odrive": {"nodes": [4, 5], "feedback_s": 0.002, "heartbeat_s": 0.1, "enable_delay_s": 0.1, **TURNS},
    "moteus": {"nodes": [4, 5], "enable_delay_s": 0.1, **TURNS},
    "vesc": {
        "nodes": [4, 5], "feedback_s": 0.002, "heartbeat_s": 0.1, "torque_constant": 0.1, "pole_pairs": 3, **TURNS,
    },
}  # fmt: skip
EVERY = {name: value for keys in OF_KIND.values() for name, value in keys.items()}


def table(kind: str, **more: object) -> EmulatedDriveConfig:
    return EmulatedDriveConfig.model_validate({"kind": kind, **({} if kind == "cia402" else TURNS), **more})


def servos() -> list[ServoDrive]:
    return [ServoDrive(axis, 2.0, 1e-7, 10 * MS, False, 0) for axis in range(2)]


# the table ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", OF_KIND)
def test_every_key_of_another_kind_is_refused_by_name(kind: str) -> None:
    made = EmulatedDriveConfig.model_validate({"kind": kind, **OF_KIND[kind]})
    assert made.model_dump(include=set(OF_KIND[kind])) == OF_KIND[kind]
    for name, value in EVERY.items():
        if name not in OF_KIND[kind]:
            with pytest.raises(ValidationError, match=f"{name}: no key of kind = '{kind}'"):
                table(kind, **{name: value})


def test_several_such_keys_are_named_in_order() -> None:
    with pytest.raises(ValidationError, match="missing, pole_pairs, torque_constant: no key of kind = 'odrive'"):
        table("odrive", torque_constant=1.0, pole_pairs=3, missing=["1017h"])


@pytest.mark.parametrize("bits", [0x0100, 0x4000, 0x8000, 0xC100, 0x0001, 0x0200, 0x1000, 0x2000])
def test_only_the_makers_bits_of_the_statusword_can_be_set(bits: int) -> None:
    if not bits & ~0xC100:
        assert table("cia402", status_bits=bits).status_bits == bits
        return
    with pytest.raises(ValidationError, match=f"status_bits = {bits:#x}: only bits 8, 14 and 15"):
        table("cia402", status_bits=bits)


@pytest.mark.parametrize("turn", [[], [0.01, 0.0]])
def test_drives_that_count_in_turns_need_one_for_every_axis(turn: list[float]) -> None:
    with pytest.raises(ValidationError, match="kind = 'vesc' needs `turn`, other than 0"):
        table("vesc", turn=turn)


def test_without_a_table_a_cia402_drive_is_as_its_file_says() -> None:
    assert stated_quirks(None) == stated_quirks(table("cia402")) == NO_QUIRKS == Quirks()
    assert (frozenset(), {}, 0, 0, 0, True, "expedited", {}) == NO_QUIRKS


def test_every_quirk_is_taken_over_in_nanoseconds_and_dictionary_keys() -> None:
    stated = {
        "missing": ["1017h", "60C2h:01"], "aborts": ["6072h", "1010h:01"], "answer_delay_s": 0.0015,
        "enable_delay_s": 0.25, "status_bits": 0x4000, "dummy_mapping": False, "answers": "segmented",
        "instead": {"6061h": 8},
    }  # fmt: skip
    quirks = stated_quirks(table("cia402", **stated))
    assert quirks.missing == {key_of(0x1017), key_of(0x60C2, 1)} == {0x101700, 0x60C201}
    assert quirks.aborts == {0x607200: 0x08000000, 0x101001: 0x08000000}  # CiA 301: general error
    assert quirks[2:] == (1_500_000, 250_000_000, 0x4000, False, "segmented", {0x606100: 8})


# the drives -----------------------------------------------------------------------------------------------------------


def test_a_turn_of_the_motor_is_a_mounting_of_its_own() -> None:
    assert installed_mountings(None, 2) == installed_mountings(table("cia402"), 2) == []
    per_radian = [2.0 * math.pi / 0.01, 2.0 * math.pi / 0.02]
    for kind in ("odrive", "vesc", "moteus"):
        made = installed_mountings(table(kind), 2)
        assert made == [Mounting(1, per_radian[0], 0), Mounting(-1, per_radian[1], 0)]


@pytest.mark.parametrize(("more", "says"), [
    ({"turn": [0.01]}, "plant.drive.turn has 1 values for 2 axes"),
    ({"nodes": [1, 2, 3]}, "plant.drive.nodes has 3 values for 2 axes"),
])  # fmt: skip
def test_lists_have_an_entry_for_every_axis(more: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        installed_mountings(table("odrive", **more), 2)


@pytest.mark.parametrize(("kind", "bus", "own", "first"), [
    ("odrive", DBC, HomingOdrive, 0), ("vesc", DBC, Vesc, 0), ("moteus", BusConfig(protocol="moteus"), Moteus, 1),
])  # fmt: skip
def test_drives_have_the_numbers_stated_or_count_from_their_first(
    kind: str, bus: BusConfig, own: type, first: int
) -> None:
    positions = [lambda: 0.005, lambda: 0.005]
    for nodes in ([], [7, 3]):
        made = installed_drives(bus, table(kind, nodes=nodes), Path(), servos(), positions, 1000)
        assert [type(drive) for drive in made] == [own] * 2
        assert [drive.node_id for drive in made] == (nodes or [first, first + 1])
        assert [drive.servo.axis for drive in made] == [0, 1]
        turns = [drive._turns() for drive in made]  # type: ignore[attr-defined]
        assert turns == pytest.approx([0.5, 0.25], rel=1e-12), "half a turn of 10 mm, a quarter of one of 20 mm"


@pytest.mark.parametrize(("stated", "nodes"), [([], [1, 2]), ([7, 3], [7, 3])])
def test_without_a_table_moteus_drives_are_those_of_the_rig(stated: list[int], nodes: list[int]) -> None:
    bus = BusConfig.model_validate({"protocol": "moteus", "moteus": {"nodes": stated}})
    made = installed_drives(bus, None, Path(), servos(), [lambda: 0.005, lambda: 0.0025], 0)
    assert [drive.node_id for drive in made] == nodes
    turns = [drive._turns() for drive in made]  # type: ignore[attr-defined]
    assert turns == pytest.approx([0.5, 0.25], rel=1e-12), "100 000 counts of 0.1 um are a turn"


def test_times_and_constants_of_the_table_are_the_drives() -> None:
    positions = [lambda: 0.0, lambda: 0.0]
    config = table("odrive", feedback_s=0.0025, heartbeat_s=0.1, enable_delay_s=0.003)
    odrive, _ = installed_drives(DBC, config, Path(), servos(), positions, 0)
    assert [period for _, period in odrive._periodic] == [2_500_000, 100_000_000]  # type: ignore[attr-defined]
    assert odrive._enable_delay_ns == 3_000_000  # type: ignore[attr-defined]
    config = table("vesc", feedback_s=0.0025, heartbeat_s=0.1, torque_constant=0.2, pole_pairs=4, nodes=[9, 8])
    vesc, _ = installed_drives(DBC, config, Path(), servos(), positions, 0)
    assert [period for _, period in vesc._periodic] == [2_500_000, 100_000_000, 100_000_000]  # type: ignore[attr-defined]
    vesc.on_frame(Frame(EXTENDED | 0x109, (1500).to_bytes(4, "big"), 0, MS))
    assert vesc.servo.force == pytest.approx(0.3, rel=1e-12)
    moteus, _ = installed_drives(
        BusConfig(protocol="moteus"), table("moteus", enable_delay_s=0.004), Path(), servos(), positions, 0
    )
    assert moteus._enable_delay_ns == 4_000_000  # type: ignore[attr-defined]


def test_drives_that_do_not_speak_the_rigs_layout_are_refused() -> None:
    for kind, bus in (
        ("odrive", BusConfig(protocol="moteus")),
        ("moteus", DBC),
        ("cia402", DBC),
        ("vesc", BusConfig()),
    ):
        text = f"plant.drive.kind = '{kind}': such drives do not speak bus.protocol = '{bus.protocol}'"
        with pytest.raises(ValueError, match=re.escape(text)):
            installed_drives(bus, table(kind), Path(), servos(), [lambda: 0.0] * 2, 0)


@pytest.mark.parametrize("name", ["paper", "microscope-ideal", "paper-dbc", "moteus", "odrive", "vesc"])
def test_emulated_drives_join_a_live_bus_as_their_host_does(name: str) -> None:
    """A classic port takes an FD frame for an error: the drives would never hear a command."""
    rig = load_rig(RIGS / f"{name}.toml", ["bus.interface=local"])
    layout, stage = rig_layout(rig, RIGS), emulated_stage(rig, RIGS, time.monotonic_ns())
    drives = open_port(rig.bus, role="device", fd=stage.fd)
    host = open_port(rig.bus, role="host", fd=layout.fd)
    frames = layout.encode(Command(0, [0.0] * len(rig.axes), 0, False))
    for frame in frames:
        assert host.send(frame)
    assert len(drives.drain(time.monotonic_ns())) == len(frames)
    assert drives.counters().errors == 0
    host.close()
    drives.close()
