"""What the cycle wrote is what a recording gives: to the last bit through hil, to the documented steps without it. And
how large it gets."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.cycle.record import MOTION_FIELDS
from hil.runs.api import RECORDING
from tests.support.paths import RIGS

# Filters with memory, four axes of both kinds, lost frames, a fault on the way.
RUNS: dict[str, tuple[str, list[str], float]] = {
    "microscope": ("microscope", [], 0.6),
    "lost frames": ("paper", ["wire.drop_probability=0.02", "law.name=structured-kalman", "task.approach_s=0.2"], 0.6),
    "a fault": ("paper", ["axes.x.limits.following_error=1e-7", "law.name=pid"], 0.4),
}
MOST_STEP_ERROR = 0.5  # of a step: values are rounded to the nearest multiple


@pytest.fixture(scope="module", params=list(RUNS))
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[hil.Run, Path]:
    """A run as the cycle wrote it, and its recording."""
    rig, overrides, seconds = RUNS[request.param]
    path = tmp_path_factory.mktemp("recorded") / RECORDING
    return hil.simulate(RIGS / f"{rig}.toml", seconds, overrides=overrides, record=path), path


def test_read_back_it_is_what_the_cycle_wrote_bit_for_bit(both: tuple[hil.Run, Path]) -> None:
    run, path = both
    recording = hil.Recording(path)
    assert recording.exact
    assert (recording.truncated, recording.lost) == (False, 0)
    assert len(recording.time) == len(run.time) > 300
    assert set(run.columns) <= set(recording.columns)
    for name, values in run.columns.items():
        found = recording.columns[name]
        if values.dtype.kind == "f":
            assert found.tobytes() == values.tobytes(), name  # also the signs of zeros
        else:
            assert found.tolist() == values.tolist(), name
    assert recording.events == run.events
    assert [event.document for event in recording.log] == [event.document for event in run.log]


def plain_ticks(path: Path) -> tuple[list[Any], dict[str, float]]:
    """Every tick of a file and the steps of its fields, by mcap and protobuf alone: no type here is hil's."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap.reader import make_reader

    found, steps = [], {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(topics=["tick"]):
            assert schema is not None
            if not found:
                pool = descriptor_pool.DescriptorPool()
                for described in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(described)
                kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
                steps = json.loads(channel.metadata["steps"])
            found.append(kind.FromString(message.data))
    return found, steps


def test_read_by_plain_mcap_and_protobuf_it_gives_the_same_series_to_the_documented_steps(
    both: tuple[hil.Run, Path],
) -> None:
    run, path = both
    ticks, steps = plain_ticks(path)
    assert [tick.sequence for tick in ticks] == list(range(len(run.time)))
    for name, field in (("index", "tick"), ("state", "state"), ("fault", "fault")):
        assert [getattr(tick, field) for tick in ticks] == run.columns[name].tolist(), name
    lateness = np.array([tick.lateness for tick in ticks])
    exact = (run.columns["now_ns"] - run.columns["scheduled_ns"]) * 1e-9
    assert np.abs(lateness - exact).max() <= MOST_STEP_ERROR * steps["lateness"]
    for number, axis in enumerate(run.axes):
        rows = [getattr(tick, axis) for tick in ticks]
        for name in MOTION_FIELDS:
            plain, step = np.array([getattr(row, name) for row in rows]), steps[f"{axis}.{name}"]
            exact = run.columns[name][:, number]
            there = np.isfinite(exact)  # setpoint and error: where a task was followed
            assert (np.isfinite(plain) == there).all(), (axis, name)
            assert np.abs(plain - exact)[there].max(initial=0.0) <= MOST_STEP_ERROR * step, (axis, name)
            assert not np.fmod(plain[there], step).any(), (axis, name)
        for name in ("age_ticks", "drive_status"):
            assert [getattr(row, name) for row in rows] == run.columns[name][:, number].tolist(), (axis, name)


@pytest.mark.slow
def test_ten_minutes_of_a_noisy_stage_take_at_most_60_megabytes(tmp_path: Path) -> None:
    seconds = 10.0
    hil.simulate(RIGS / "microscope.toml", seconds, record=tmp_path / RECORDING)
    assert (tmp_path / RECORDING).stat().st_size * 600.0 / seconds <= 60e6
