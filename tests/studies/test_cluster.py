"""`hil sweep --scheduler`: the same command on a real dask.distributed cluster gives the numbers of a local run."""

import importlib.util
import json
import os
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.studies.crew import crew, resumed
from tests.support.paths import ROOT

PAPER = ROOT / "deploy" / "rigs" / "paper.toml"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1", "law.name=structured-kalman"]

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="needs the extra: pip install 'hil[cluster]'"
)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A scheduler and two worker processes on the loopback interface."""
    from distributed import LocalCluster  # type: ignore[attr-defined,unused-ignore]

    cluster: Any = LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    )
    with cluster:
        yield cluster.scheduler_address


def sweep(tmp_path: Path, name: str, *options: str) -> dict[str, Any]:
    """What `hil sweep` found for seven plants with ripple and Stribeck friction."""
    target = tmp_path / f"{name}.json"
    sets = [word for change in QUICK for word in ("--set", change)]
    arguments = ["sweep", str(PAPER), "--plants", "7", "--seconds", "0.7", "--hard", "--worst", "1", *sets]
    outcome = CliRunner().invoke(
        build_app("sweep"), [*arguments, "--out", str(tmp_path / name), "--json", str(target), *options]
    )
    assert outcome.exit_code == 0, outcome.output
    return json.loads(target.read_text())["laws"]["structured-kalman"]  # type: ignore[no-any-return]


@pytest.mark.slow
def test_a_cluster_finds_the_same_numbers_as_this_machine(tmp_path: Path, address: str) -> None:
    here = sweep(tmp_path, "here", "--workers", "1")
    there = sweep(tmp_path, "there", "--scheduler", address)
    assert len(chunks_done(address)) == 2  # one for each worker
    assert here["axes"] == there["axes"]
    assert [(case["plant"], case["max_error"]) for case in here["worst"]] == [
        (case["plant"], case["max_error"]) for case in there["worst"]
    ]
    assert there["worst"][0]["reproduced"]


def ran(command: str, options: list[str], tmp_path: Path, name: str) -> str:
    """The JSON that a command wrote."""
    target = tmp_path / f"{name}.json"
    words = [command, *options, "--json", str(target)]
    outcome = CliRunner().invoke(build_app(command), words)
    assert outcome.exit_code == 0, outcome.output
    return target.read_text()


BROUGHT = ["--set", "law.name=./lqr.py:Lqr", "--set", "task.kind=./rose.py:Rose", "--set", "task.axes=['x', 'y']",
           "--set", "plant.stage=./leaning.py:Leaning", "--set", "task.approach_s=0.2",
           "--set", "plant.parameters.stiffness=0.1",
           # its springs move it before it has torque
           "--set", "axes.x.limits.standstill=0.005", "--set", "axes.y.limits.standstill=0.005"]  # fmt: skip
COMMANDS = {
    "compare": ["--laws", "pd-feedforward,./lqr.py:Lqr", "--seconds", "1", "--undisturbed"],
    "faults": ["--stride", "97", *BROUGHT],
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_plug_ins_and_rig_travel_and_the_bytes_are_the_same(
    command: str, tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for file in ("laws/lqr.py", "tasks/rose.py", "stages/leaning.py"):
        shutil.copy(ROOT / "examples" / file, tmp_path)
    shutil.copy(PAPER, tmp_path)
    options = ["paper.toml", *COMMANDS[command]]
    here = ran(command, [*options, "--workers", "1"], tmp_path, "here")
    assert ran(command, [*options, "--scheduler", address], tmp_path, "there") == here
    assert not any((tmp_path / "runs" / ".unfinished").glob("*"))


@pytest.mark.slow
def test_tune_finds_the_same_gains(tmp_path: Path, address: str) -> None:
    quick = [
        "--population",
        "5",
        "--generations",
        "1",
        "--law",
        "pid",
        "--dry-run",
        "--margin",
        "0",
        "--phase-margin",
        "0",
    ]
    words = ["tune", str(PAPER), *quick]
    here, there = (CliRunner().invoke(build_app("tune"), [*words, *more]) for more in ([], ["--scheduler", address]))
    assert here.exit_code == there.exit_code == 0, here.output + there.output
    assert here.stdout == there.stdout


def slow_square(number: int) -> int:
    """A job that takes half a second."""
    time.sleep(0.5)
    return number * number


def worker_of(address: str) -> int:
    """The process of one of the cluster's workers that has something to do."""
    from distributed import Client  # type: ignore[attr-defined,unused-ignore]

    with Client(address) as client:
        busy = [worker for worker, tasks in client.processing().items() if tasks]
        return int(client.run(os.getpid, workers=busy[:1])[busy[0]])


@pytest.mark.slow
def test_a_worker_that_is_killed_on_the_way_costs_nothing(address: str, tmp_path: Path) -> None:
    with crew(0, address) as hands:
        results = resumed(hands, slow_square, list(range(12)), tmp_path)
        found = [next(results)]
        os.kill(worker_of(address), signal.SIGKILL)
        found += results
    assert found == [number * number for number in range(12)]


def counted(job: tuple[str, int]) -> int:
    """Leaves a mark for every time it is done."""
    folder, number = job
    mark = Path(folder) / f"{number}.done"
    mark.write_text(mark.read_text() + "x" if mark.exists() else "x")
    return -number


def test_an_interrupted_run_goes_on_where_it_was(tmp_path: Path) -> None:
    work = [(str(tmp_path), number) for number in range(6)]
    with crew(1) as hands:
        results = resumed(hands, counted, work, tmp_path / "kept")
        assert [next(results) for _ in range(3)] == [0, -1, -2]
        results.close()  # type: ignore[attr-defined]
    (place,) = (tmp_path / "kept").iterdir()
    assert len(list(place.glob("*.pickle"))) == 3
    (place / "1.pickle").write_bytes(b"cut short")
    done = {number: (tmp_path / f"{number}.done").read_text() for number in range(3)}
    with crew(1) as hands:
        assert list(resumed(hands, counted, work, tmp_path / "kept")) == [0, -1, -2, -3, -4, -5]
    assert (tmp_path / "0.done").read_text() == done[0]
    assert (tmp_path / "1.done").read_text() == done[1] + "x"
    assert list((tmp_path / "kept").iterdir()) == []


def chunks_done(address: str) -> set[str]:
    """Keys of the chunks that the cluster's workers finished."""
    from distributed import Client  # type: ignore[attr-defined,unused-ignore]

    def finished(dask_scheduler: Any) -> set[str]:
        return {str(key) for key, _, finish, *_ in dask_scheduler.transition_log if finish == "memory"}

    with Client(address) as client:
        return {key for key in client.run_on_scheduler(finished) if key.startswith("run_chunk")}


def test_a_scheduler_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.studies.crew.CONNECT_TIMEOUT_S", 0.2)
    outcome = CliRunner().invoke(
        build_app("sweep"), ["sweep", str(PAPER), "--out", str(tmp_path), "--scheduler", "tcp://127.0.0.1:9"]
    )
    assert outcome.exit_code != 0
    assert "tcp://127.0.0.1:9" in str(outcome.exception)
