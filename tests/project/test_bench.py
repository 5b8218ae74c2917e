"""Benchmarks count what they claim to count."""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from hil.operate.bench.blocks import Block, Case, as_json, interleave, percentiles, publish, ratios, spread, values_of
from hil.operate.bench.jitter import lateness_in_histogram
from hil.operate.bench.live_runs import (
    ATTEMPTS,
    BenchError,
    DisturbedError,
    calls_per_tick,
    cores,
    fault_words,
    undisturbed,
)
from hil.operate.machine import machine_facts
from hil.rig.file import load_rig
from tests.benchmarks import linuxcnc, tick, walking
from tests.benchmarks.c_programs import build_reference
from tests.benchmarks.lockstep import measure
from tests.benchmarks.tick import allocations_per_tick
from tests.support.paths import ROOT

RIG = ROOT / "deploy" / "rigs" / "paper.toml"


def test_cases_take_turns_and_every_second_round_runs_backwards():
    order = []

    def case(name):
        return Case(name, lambda: order.append(name) or {"value": float(len(order))})

    blocks = interleave([case("a"), case("b"), case("c")], 3)
    assert order == ["a", "b", "c", "c", "b", "a", "a", "b", "c"]
    assert values_of(blocks, "a", "value") == [1.0, 6.0, 7.0]


def test_ratios_are_formed_inside_a_block_so_that_shared_disturbances_cancel():
    blocks = [Block("ours", 1, {"us": 30.0}), Block("theirs", 1, {"us": 10.0})]
    blocks += [Block("theirs", 0, {"us": 100.0}), Block("ours", 0, {"us": 300.0})]
    assert ratios(blocks, "ours", "theirs", "us") == [3.0, 3.0]


def test_spread_and_percentiles():
    assert spread([3.0, 1.0, 2.0]) == (1.0, 2.0, 3.0)
    figures = percentiles(np.arange(1001))
    assert figures == pytest.approx({"p50": 500, "p99": 990, "p999": 999, "max": 1000})
    with pytest.raises(ValueError, match="empty"):
        spread([])


def test_json_carries_the_result_all_blocks_and_the_machine(tmp_path, capsys):
    path = tmp_path / "out.json"
    blocks = [Block("ours", 0, {"us": 30.0})]
    publish({"ratio": 3, "blocks": as_json(blocks)}, [], str(path))
    written = json.loads(path.read_text())
    assert written["ratio"] == 3
    assert written["blocks"] == [{"case": "ours", "block": 0, "us": 30.0}]
    assert written["machine"]["kernel"] == machine_facts()["kernel"]
    capsys.readouterr()
    publish({"ratio": 3}, [], "-")
    assert json.loads(capsys.readouterr().out)["ratio"] == 3


STRACE = """\
% time     seconds  usecs/call     calls    errors syscall
------ ----------- ----------- --------- --------- ----------------
 52.00    0.104000          52      2000           clock_nanosleep
 24.00    0.048000          24      2000           recvmmsg
 20.00    0.040000          20      2000         3 sendto
  4.00    0.008000          16       500           openat
------ ----------- ----------- --------- --------- ----------------
100.00    0.200000          30      6500         3 total
"""


def test_a_block_that_the_host_spoils_is_measured_again_and_anything_else_is_not():
    def measure():
        outcome = outcomes.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    outcomes = [DisturbedError("stalled"), DisturbedError("stalled"), 7]
    assert undisturbed(measure) == (7, 2)
    outcomes = [DisturbedError(f"stall {attempt}") for attempt in range(ATTEMPTS + 1)]
    with pytest.raises(BenchError, match=f"{ATTEMPTS} attempts failed; the last one: stall {ATTEMPTS - 1}"):
        undisturbed(measure)
    outcomes = [BenchError("no compiler"), 7]
    with pytest.raises(BenchError, match=r"^no compiler$"):
        undisturbed(measure)


@pytest.mark.parametrize(("allowed", "shared_out"), [({2, 3, 7}, (2, 7)), ({5}, (5, 5))])
def test_the_loop_has_a_core_of_its_own_where_there_are_two(monkeypatch, allowed, shared_out):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: allowed)
    assert cores() == shared_out


def test_system_calls_are_counted_per_pacing_sleep():
    assert calls_per_tick(STRACE) == 3.25
    assert calls_per_tick("strace: attach: Operation not permitted") is None


CYCLICTEST = """\
# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000012 000003
000013 000001
# Total: 000000005
# Min Latencies: 00012
# Histogram Overflows: 00001
# Thread 0: 4
"""


def test_the_histogram_of_cyclictest_is_read_bin_by_bin_and_overflows_count():
    assert sorted(lateness_in_histogram(CYCLICTEST).tolist()) == [12.5, 12.5, 12.5, 13.5, 20_000.0]


needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler: C references are not built")


@needs_compiler
@pytest.mark.parametrize(("source", "first"), [(tick.C_SOURCE, "BUS_DIRECTORY"), (walking.C_SOURCE, "PERIODS")])
def test_a_c_reference_compiles_and_says_how_it_is_called(source, first, tmp_path):
    program = build_reference(source, tmp_path)
    done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"{program.name} {first}" in done.stderr


@pytest.mark.long
@needs_compiler
def test_the_program_that_walks_books_the_slots_that_it_works_through_as_its_own(tmp_path):
    rig = load_rig(RIG, ["timing.priority=1"])
    program = build_reference(walking.C_SOURCE, tmp_path)
    figures = walking.walking(program, rig, periods=20, work_ns=2.5 * rig.period_ns)
    assert figures["own_misses"] > 0
    assert figures["own_misses"] + figures["host_misses"] >= 20  # at least one a period, two where none begins late


@pytest.mark.long
def test_a_lockstep_block_measures_itself_and_memory_does_not_grow():
    rig = load_rig(RIG)
    figures = measure(rig, RIG.parent, 0.3)
    assert figures["realtime_factor"] > 0
    assert 0 < figures["cycle_us"] < 1e6
    assert allocations_per_tick(rig, RIG.parent, 500) < 0.5


@pytest.mark.long
@pytest.mark.parametrize("module", ["tests.benchmarks.__main__", "hil.operate.bench.command"])
def test_a_list_of_benchmarks_loads_none_of_them(module):
    code = f"import sys; sys.argv = ['hil', 'bench', '--help']; import {module} as command\n"
    code += "targets = [entry.target.partition(':')[0] for entry in command.BENCHES.values()]\n"
    code += "assert targets and not set(targets) & set(sys.modules)\n"
    code += "import importlib; [importlib.import_module(name) for name in targets]"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_what_people_measure_at_a_rig_needs_no_tests():
    code = "import sys, hil.operate.bench.jitter; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert not [name for name in loaded if name.split(".")[0] == "tests"]


def test_a_fault_that_ends_a_benchmark_is_named() -> None:
    assert fault_words(8) == "FOLLOWING_ERROR (8)"
    assert fault_words(9999) == "9999"


def test_linuxcnc_is_given_as_many_controllers_as_the_stage_has_axes(tmp_path) -> None:
    lines = linuxcnc.hal_file(2.5).splitlines()
    assert lines[0] == "loadrt threads name1=servo period1=1000000"
    assert sum(line.startswith("addf pid.") for line in lines) == 4
    assert lines.index("start") < lines.index("loadusr -w sleep 2.5") < lines.index("getp timedelta.0.jitter")


def test_cpu_time_of_a_thread_is_told_by_its_sleeps(tmp_path) -> None:
    (tmp_path / "status").write_text("Name:\tx\nvoluntary_ctxt_switches:\t4130\nnonvoluntary_ctxt_switches:\t7\n")
    (tmp_path / "schedstat").write_text("59978415 595649015 4100\n")
    assert linuxcnc._taken(tmp_path / "schedstat") == (59978415, 4130)
