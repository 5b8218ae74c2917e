"""A record that is written over and over by machine words, against one made anew by the names of its fields."""

from random import Random
from typing import Any

import numpy as np
import pytest

from drivers.frame import Frame
from hil.cycle.fault_evidence import Evidence
from hil.cycle.record import (
    MAX_COMMANDS,
    MAX_EVIDENCE,
    MAX_RECEIVED,
    MAX_SENT,
    MOTION_FIELDS,
    NO_AXIS,
    RECORD,
    REJECT_REASONS,
)
from hil.cycle.record_builder import RecordBuilder
from hil.cycle.tick import OperatorCommand, PortCounters, Tick
from hil.rig.schema import MAX_AXES
from tests.support.records import put_axis

U16, U32, I63, U64 = 2**16 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1


def some(rng: Random, count: int, most: int) -> list[int]:
    """Numbers of any size up to `most`, the least and the most themselves among them; at times nothing but zeros."""
    if rng.random() < 0.2:
        return [0] * count
    return [rng.choice((0, most, rng.randint(0, most) >> rng.randint(0, most.bit_length()))) for _ in range(count)]


def frame(rng: Random) -> Frame:
    """Of any length."""
    return Frame(some(rng, 1, U32)[0], rng.randbytes(rng.randint(0, 64)), rng.randint(0, 255), rng.randint(-I63, I63))


def command(rng: Random) -> tuple[OperatorCommand, bool]:
    """Whether accepted with it."""
    kind, sequence = some(rng, 1, U32) + some(rng, 1, U64)
    return OperatorCommand(kind, sequence, rng.choice((1, -1)) * some(rng, 1, 2 * I63)[0]), rng.random() < 0.5


def drawn(rng: Random, n_axes: int) -> dict[str, Any]:
    """What one tick leaves in its record."""
    found = [Evidence(rng.randint(0, U16), rng.randint(NO_AXIS, 3), rng.random(), rng.random()) for _ in range(10)]
    return {
        "head": some(rng, 7, I63), "state": some(rng, 2, U32 >> 1), "flags": rng.randint(0, 63),
        "motion": [[rng.gauss(0.0, 1.0) for _ in range(9)] for _ in range(n_axes)], "axes": some(rng, 2 * n_axes, I63),
        "told": {axis: (rng.random(), rng.random()) for axis in range(n_axes) if rng.random() < 0.3},
        "drives": some(rng, 2 * n_axes, U32), "port": some(rng, 12, I63), "rejects": some(rng, REJECT_REASONS, I63),
        "counts": some(rng, 7, I63), "spent": some(rng, 6, 2**33), "evidence": found[: rng.randint(0, len(found))],
        "commands": [command(rng) for _ in range(rng.randint(0, MAX_COMMANDS))],
        "sent": [frame(rng) for _ in range(rng.randint(0, MAX_SENT))],
        "received": [frame(rng) for _ in range(rng.randint(0, MAX_RECEIVED))],
    }  # fmt: skip


def written(builder: RecordBuilder, tick: dict[str, Any]) -> np.void:
    """As the cycle and its shell write it."""
    index, scheduled, now, active, sequence, task, _ = tick["head"]
    stop, recorder, realtime, rig, sending, estop = (bool(tick["flags"] >> bit & 1) for bit in range(6))
    port = PortCounters._make(tick["port"])
    n, drives, counts = len(tick["motion"]), tick["drives"], tick["counts"]
    it = Tick(
        index, scheduled, now, port, stop=stop, recorder_ok=recorder, realtime_ok=realtime, rig_ok=rig, estop=estop
    )
    builder.tick(it, *tick["state"], active, sending=sending)
    builder.progress(sequence, task)
    for axis, values in enumerate(tick["motion"]):
        put_axis(builder, axis, values, tick["axes"][axis], tick["axes"][n + axis])
    for axis, estimate in tick["told"].items():
        builder.estimate(axis, *estimate)
    builder.drives(drives[:n], drives[n:])
    builder.counters(port, tick["rejects"], *counts[:3])
    builder.law_floors(counts[3])
    builder.evidence(tick["evidence"])
    builder.spent(*tick["spent"][:5])
    builder.missed(*counts[4:], tick["spent"][5])
    return builder.traffic(tick["commands"], tick["sent"], tick["received"])


def plain(tick: dict[str, Any], evidence_before: int) -> np.void:
    """The same by name, in a record of zeros."""
    record = np.zeros(1, RECORD)[0]
    for name, value in zip(("index", "scheduled_ns", "now_ns", "faults_active"), tick["head"], strict=False):
        record[name] = value
    record["state"], record["fault"] = tick["state"]
    record["flags"], record["sequence"], record["task_ns"] = tick["flags"], tick["head"][4] & U32, tick["head"][5]
    n = len(tick["motion"])
    for axis, values in enumerate(tick["motion"]):
        rows = [*values[:7], values[0] - values[5], *values[7:]]
        for name, value in zip(MOTION_FIELDS, rows, strict=True):
            record[name][axis] = value
    for axis, estimate in tick["told"].items():
        record["position_estimate"][axis], record["velocity_estimate"][axis] = estimate
    record["stamp_ns"][:n], record["saturations"][:n] = tick["axes"][:n], tick["axes"][n:]
    record["age_ticks"][:n], record["drive_status"][:n] = tick["drives"][:n], tick["drives"][n:]
    record["port"], record["rejects"] = tick["port"], tick["rejects"]
    names = ("samples_lost", "illegal_events", "commands_refused", "law_floors")
    for name, value in zip((*names, "missed_own", "missed_host", "longest_streak"), tick["counts"], strict=True):
        record[name] = value
    record["cpu_ns"], record["run_delay_ns"] = np.minimum(tick["spent"][:5], U32), min(tick["spent"][5], U32)
    for name in ("commands", "received", "sent", "evidence"):
        record[f"n_{name}"] = len(tick[name])
    for place, (command, accepted) in zip(record["commands"], tick["commands"], strict=False):
        place["kind"], place["accepted"] = command.kind, accepted
        place["sequence"], place["expires_ns"] = command.sequence, min(max(command.expires_ns, -I63 - 1), I63)
    record["evidence_total"] = evidence_before + len(tick["evidence"])
    for place, (fault, axis, value, limit) in enumerate(tick["evidence"][:MAX_EVIDENCE]):
        record["evidence_of"][place] = fault | (axis & U16) << 16
        record["evidence_value"][place], record["evidence_limit"][place] = value, limit
    for name in ("sent", "received"):
        for place, frame in zip(record[name], tick[name], strict=False):
            place["timestamp_ns"], place["can_id"], place["flags"] = frame.timestamp_ns, frame.can_id, frame.flags
            place["length"], place["data"][: len(frame.data)] = len(frame.data), list(frame.data)
    return record


@pytest.mark.parametrize("n_axes", range(1, MAX_AXES + 1))
def test_a_record_is_what_its_tick_put_there_whatever_the_ticks_before_left(n_axes: int) -> None:
    """Of commands, frames and evidence the counted ones; behind them may be what is left of earlier ticks."""
    rng, builder, total = Random(n_axes), RecordBuilder(n_axes), 0
    tick = drawn(rng, n_axes)
    for _ in range(60):
        kept = rng.sample(sorted(tick), rng.randint(0, len(tick)))  # as in the tick before
        tick = drawn(rng, n_axes) | {name: tick[name] for name in kept}
        record, expected = written(builder, tick), plain(tick, total)
        total += len(tick["evidence"])
        counted = {name: len(tick[name]) for name in ("commands", "sent", "received")}
        evidence = min(len(tick["evidence"]), MAX_EVIDENCE)
        counted |= dict.fromkeys(("evidence_of", "evidence_value", "evidence_limit"), evidence)
        for name in RECORD.names or ():
            shown = slice(counted[name]) if name in counted else ...
            assert record[name][shown].tobytes() == expected[name][shown].tobytes(), name


def test_readings_are_kept_by_channel_and_an_age_too_large_is_cut() -> None:
    builder = RecordBuilder(1)
    builder.readings([0.5, -2.0, 1e-9, 4.0, 5.0], [0, 1, 2, 0xFFFF, 10**6])
    record = builder.traffic([], [], [])
    assert record["readings"].tolist() == [0.5, -2.0, 1e-9, 4.0, 5.0, 0.0, 0.0, 0.0]
    assert record["reading_age"].tolist() == [0, 1, 2, 0xFFFF, 0xFFFF, 0, 0, 0]


def test_more_evidence_than_its_count_can_say_is_cut_and_raises_nothing() -> None:
    builder = RecordBuilder(1)
    for count, said in ((2**15, 2**15 - 1), (5, 5)):
        builder.evidence([Evidence(1, 0, 0.5, 0.25)] * count)
        assert builder.traffic([], [], [])["n_evidence"] == said
    assert builder.record["evidence_total"] == 2**15 + 5
