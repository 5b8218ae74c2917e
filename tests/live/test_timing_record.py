"""Histograms that a loop can afford, and that a reader can trust."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from librt.vecs import vec
from mypy_extensions import i64

from hil.live.timing_record import BINS, METRICS, SUB_BINS, WINDOW, TimingRecorder, bin_edge, bin_of, read_timing

LATENESS = METRICS.index("lateness")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "rig.timing"


def recorder(path):
    return TimingRecorder(path, 1_000_000, realtime_ok=False, verdict="priority refused (denied; run as root) – é")


def note_all(record, lateness):
    """Ticks of a loop that has ended then."""
    note(record, lateness)
    record.show()


def note(record, lateness):
    for value in lateness:
        row = [100] * len(METRICS)
        row[LATENESS] = int(value)
        record.note(vec[i64](row))


@given(st.integers(1, 2**36 - 1))
def test_every_value_lies_within_the_edges_of_its_bin(value):
    index = bin_of(value)
    assert bin_edge(index) <= value < bin_edge(index + 1)
    assert bin_edge(index + 1) / bin_edge(index) <= 1 + 1 / SUB_BINS


@pytest.mark.parametrize(("value", "index"), [(-5, 0), (0, 0), (1, 0), (2**36, BINS - 1), (2**62, BINS - 1)])
def test_values_outside_the_range_go_to_the_end_bins(value, index):
    assert bin_of(value) == index


def test_quantiles_agree_with_the_samples_to_a_bin(path):
    values = np.random.default_rng(1).lognormal(10, 1, 5000).astype(np.int64)
    record = recorder(path)
    note_all(record, values)
    snapshot = read_timing(path)
    for fraction in (0.01, 0.5, 0.99, 0.999):
        exact = np.quantile(values, fraction)
        assert snapshot.quantile("lateness", fraction) == pytest.approx(exact, rel=1.5 / SUB_BINS)
    assert snapshot.maximum["lateness"] == values.max()
    assert snapshot.counters["ticks"] == len(values)
    assert snapshot.lifetime.sum(axis=1).tolist() == [len(values)] * len(METRICS)


@given(st.integers(0, 800))
def test_no_tick_is_lost_or_counted_twice_whatever_the_length_of_the_run(tmp_path_factory, ticks):
    file = tmp_path_factory.mktemp("timing") / "rig.timing"
    record = recorder(file)
    note_all(record, range(1, ticks + 1))
    snapshot = read_timing(file)
    expected = np.bincount([bin_of(value) for value in range(1, ticks + 1)], minlength=BINS)
    assert snapshot.lifetime[LATENESS].tolist() == expected.tolist()
    assert snapshot.counters["ticks"] == ticks


@pytest.mark.parametrize(("period_ns", "behind"), [(1_000_000, 250), (500_000, 500), (50_000_000, 8)])
def test_who_reads_the_file_while_the_loop_runs_is_a_quarter_of_a_second_behind(path, period_ns, behind):
    """Or eight ticks, where that is longer: each tick shows one histogram at the most."""
    record = TimingRecorder(path, period_ns, realtime_ok=True, verdict="")
    for ticks in range(1, 1500, 37):
        note(record, [50_000 + ticks] * 37)
        snapshot = read_timing(path)
        counted = snapshot.lifetime.sum(axis=1)
        assert (counted <= ticks + 36).all()
        assert (counted > ticks + 36 - behind).all()
    assert snapshot.quantile("lateness", 0.5) == pytest.approx(50_700, rel=1 / SUB_BINS)
    assert 50_000 < snapshot.maximum["lateness"] <= 50_000 + ticks


def test_the_window_forgets_what_the_lifetime_remembers(path):
    record = recorder(path)
    note_all(record, [8_000_000] * WINDOW)
    note_all(record, [20_000] * (WINDOW + len(METRICS)))
    snapshot = read_timing(path)
    assert snapshot.quantile("lateness", 0.5, window=True) == pytest.approx(20_000, rel=1 / SUB_BINS)
    assert snapshot.quantile("lateness", 0.99) == pytest.approx(8_000_000, rel=1 / SUB_BINS)
    assert snapshot.window.sum(axis=1).tolist() == [WINDOW] * len(METRICS)


def test_the_verdict_and_the_counters_reach_the_reader(path):
    record = recorder(path)
    record.note_missed(1, 7, 3)
    record.note_usage(run_delay_ns=12_345, collector_runs=2)
    snapshot = read_timing(path)
    assert not snapshot.realtime_ok
    assert snapshot.verdict.endswith("run as root) – é")
    counters = snapshot.counters
    assert (counters["missed_own"], counters["missed_host"], counters["longest_streak"]) == (1, 7, 3)
    assert (counters["run_delay_ns"], counters["collector_runs"]) == (12_345, 2)
    assert counters["voluntary_switches"] + counters["minor_faults"] > 0


def test_what_is_no_timing_file_is_refused(path):
    path.write_bytes(b"something else")
    with pytest.raises(ValueError, match="not a timing file"):
        read_timing(path)


def test_an_empty_histogram_has_no_quantile(path):
    recorder(path)
    assert np.isnan(read_timing(path).quantile("age", 0.5))
