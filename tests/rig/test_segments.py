"""[[bus.segments]] in the rig file: what is refused, by key, and what the rig's traffic is then."""

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.operate.install import network_files, rig_links, unit_drop_in
from hil.rig.bus_load import messages_by_segment, rig_layout
from hil.rig.file import build_rig, load_rig
from hil.rig.schema import RigError
from hil.rig.segments import rig_on, segment_rigs
from hil.studies.sweep.plants import jobs
from tests.support.judged import analysed
from tests.support.paths import RIGS
from tests.support.two_segments import TWO, TWO_PAIRS

PAPER, MICROSCOPE = RIGS / "paper.toml", RIGS / "microscope-ideal.toml"


def segments(*parts: tuple[str, str]) -> str:
    tables = (f'{{channel="{channel}",axes={axes.split()}}}' for channel, axes in parts)
    return f"bus.segments=[{','.join(tables)}]"


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        ([segments(("can0", "x"), ("can1", "y z"))], "bus.segments: axes x, y, z; every axis has to be on one segment"),
        ([segments(("can0", "x"), ("can1", "x y"))], "bus.segments: axes x, x, y"),
        ([segments(("can0", "y"), ("can1", "x"))], "in the order of [axes]: x, y"),
        ([segments(("can0", "x"), ("can0", "y"))], "segments: a channel twice in can0, can0"),
        ([segments(("can0", "x y"))], "segments: one alone; say channel = 'can0'"),
        ([segments(("no such channel", "x"), ("can1", "y"))], "bus.segments"),
        ([segments(("can4", "x"), ("can1", "y"))], "channel = 'can0': beside `segments` it is the first one's, 'can4'"),
        ([*TWO, "bus.interface=pcan"], "segments: with interface = auto, socketcan, local alone"),
        (['bus.segments=[{channel="can0",axes=["x"],bitrate=1},{channel="can1",axes=["y"]}]'], "bitrate"),
    ],
)
def test_segments_that_cannot_be_are_refused_by_key(overrides: list[str], reason: str) -> None:
    with pytest.raises(RigError) as refused:
        load_rig(PAPER, overrides)
    assert reason in str(refused.value)


@pytest.mark.parametrize(
    ("name", "overrides", "reason"),
    [
        (
            "paper-dbc",
            'bus.dbc.enable=[{message="Command_X",signal="Enable"}]',
            "bus.dbc.enable has 1 entries; with bus.segments one per axis, 2, are needed",
        ),
        (
            "odrive",
            'bus.dbc.error=[{message="Heartbeat0",signal="Axis_Error"},{message="Heartbeat0",signal="Axis_Error"}]',
            "bus.segments: message Heartbeat0 has signals of axes on can0 and on can1",
        ),
    ],
)
def test_a_dbc_message_is_of_one_segment(name: str, overrides: str, reason: str) -> None:
    with pytest.raises(RigError) as refused:
        rig_layout(load_rig(RIGS / f"{name}.toml", [*TWO, overrides]), RIGS)
    assert reason in str(refused.value)


@pytest.mark.parametrize("name", ["paper", "paper-dbc", "moteus", "odrive", "vesc"])
def test_a_layout_tells_no_more_on_two_segments_than_on_one(name: str) -> None:
    hosts = [rig_layout(load_rig(RIGS / f"{name}.toml", overrides), RIGS) for overrides in ((), TWO)]
    for what in ("checksum", "states", "causes", "tells", "fd", "sequence_modulus", "state_ns", "positions"):
        one, two = (getattr(host, what) for host in hosts)
        assert one == two, what


def test_a_checksum_on_one_segment_alone_is_none_of_the_rig() -> None:
    signals = ",".join(f'{{message="{name}A",signal="Checksum"}}' for name in ("TorqueDemand", "MotorFeedback"))
    sets = f"bus.dbc.checksum=[{signals}]"
    for overrides in ((), TWO):
        assert not rig_layout(load_rig(RIGS / "paper-dbc.toml", [*overrides, sets]), RIGS).checksum


def test_canopen_has_a_sync_and_a_service_frame_more_with_every_segment() -> None:
    four = segments(("can0", "x"), ("can1", "y"), ("can2", "z"), ("can3", "theta"))
    layout = rig_layout(load_rig(MICROSCOPE, [four, "bus.protocol=cia402"]), RIGS)
    assert sum(message.sender == "host" for message in layout.messages(1_000_000)) == 12


def test_a_sweep_which_has_one_wire_refuses_them() -> None:
    with pytest.raises(RigError, match="hil sweep batches the layout stage_fd on one wire"):
        jobs(load_rig(PAPER, [*TWO]), RIGS, 1, 1.0, 1)


def test_no_two_drives_share_an_identifier_whatever_segment_they_are_on() -> None:
    for overrides in ((), ("bus.protocol=stage_classic",), ("bus.protocol=cia402",)):
        rig = load_rig(MICROSCOPE, [*TWO_PAIRS, *overrides])
        parts = messages_by_segment(rig, rig_layout(rig, RIGS))
        ids = [[message.can_id for message in part if message.sender != "host"] for part in parts]
        assert not set(ids[0]) & set(ids[1])
        assert [{m.sender for m in part} for part in parts] == [
            {"host", "axis 0", "axis 1"},
            {"host", "axis 2", "axis 3"},
        ]


def test_the_load_is_that_of_the_busiest_segment_and_less_than_of_one() -> None:
    one = analysed(load_rig(MICROSCOPE))
    two = analysed(load_rig(MICROSCOPE, [*TWO_PAIRS]))
    uneven = analysed(load_rig(MICROSCOPE, [segments(("can0", "x y z"), ("can1", "theta"))]))
    assert two.bus_load < uneven.bus_load < one.bus_load
    assert {response.frame.split()[0] for response in two.responses} == {"can0", "can1"}


def test_traffic_that_fits_no_single_segment_fits_two() -> None:
    rates = ["rate_hz=2000", "bus.protocol=stage_classic"]
    assert not analysed(load_rig(MICROSCOPE, rates)).schedulable
    assert analysed(load_rig(MICROSCOPE, [*rates, *TWO_PAIRS])).schedulable


def test_a_rig_travels_as_a_document() -> None:
    rig = load_rig(MICROSCOPE, [segments(("can0", "x y"), ("can7", "z theta"))])
    assert build_rig(rig.model_dump(mode="json")) == rig
    named: dict[str, Any] = load_rig(PAPER).model_dump(mode="json")
    del named["bus"]["channel"]
    named["bus"]["segments"] = [{"channel": "can5", "axes": ["x"]}, {"channel": "can6", "axes": ["y"]}]
    rig = build_rig(named)
    assert (rig.bus.channel, rig.bus.channels) == ("can5", ["can5", "can6"])
    assert build_rig(rig.model_dump(mode="json")) == rig


def test_a_segment_by_itself_is_a_rig_with_its_axes() -> None:
    rig = load_rig(RIGS / "moteus.toml", [*TWO])
    parts = segment_rigs(rig)
    assert [(part.axis_names, part.bus.channel) for part in parts] == [(["x"], "can0"), (["y"], "can1")]
    assert [part.bus.moteus.nodes for part in parts if part.bus.moteus] == [[1], [2]]
    assert rig_on(rig, "can1").axis_names == ["y"]
    with pytest.raises(RigError, match="the rig is on can0, can1, not on can2"):
        rig_on(rig, "can2")
    alone = load_rig(PAPER)
    assert segment_rigs(alone) == [alone]
    assert rig_on(alone, "any") is alone


def test_a_rig_that_cannot_be_taken_apart_is_refused_with_the_reason() -> None:
    shared = 'bus.dbc.enable=[{message="TorqueDemandA",signal="PowerStage"}]'
    with pytest.raises(RigError, match=r"bus\.dbc\.enable has 1 entries"):
        segment_rigs(load_rig(RIGS / "paper-dbc.toml", [*TWO, shared]))


def test_every_interface_is_set_up_and_waited_for() -> None:
    rig = load_rig(MICROSCOPE, [*TWO_PAIRS])
    assert set(network_files(rig.bus, fd=True)) == {
        f"etc/systemd/network/80-hil-{channel}.{kind}" for channel in ("can0", "can1") for kind in ("network", "link")
    }
    devices = ["sys-subsystem-net-devices-can0.device", "sys-subsystem-net-devices-can1.device"]
    assert f"BindsTo={' '.join(devices)}\nAfter={' '.join(devices)}\n" in unit_drop_in(rig)
    links = rig_links(rig, "usr/lib/systemd/system", emulator=False)
    for device in devices:
        assert f"etc/systemd/system/{device}.wants/hil-control@{rig.name}.service" in links


def test_check_shows_both_segments(tmp_path: Path) -> None:
    picture = str(tmp_path / "tick.png")
    result = CliRunner().invoke(
        build_app("check"), ["check", str(PAPER), "--set", TWO[0], "--json", "-", "--picture", picture]
    )
    assert '"can1 feedback 0"' in result.output
    assert "stage_fd on can0 (x), can1 (y), 1000000 bit/s" in result.output
