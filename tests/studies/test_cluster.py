"""`hil sweep --scheduler`: the same command on a real dask.distributed cluster gives the numbers of a local run."""

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
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
        build_app("sweep"), [*arguments, "--output", str(tmp_path / name), "--json", str(target), *options]
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


def chunks_done(address: str) -> set[str]:
    """Keys of the chunks that the cluster's workers finished."""
    from distributed import Client  # type: ignore[attr-defined,unused-ignore]

    def finished(dask_scheduler: Any) -> set[str]:
        return {str(key) for key, _, finish, *_ in dask_scheduler.transition_log if finish == "memory"}

    with Client(address) as client:
        return {key for key in client.run_on_scheduler(finished) if key.startswith("run_chunk")}


def test_a_scheduler_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.studies.sweep.plants.CONNECT_TIMEOUT_S", 0.2)
    outcome = CliRunner().invoke(
        build_app("sweep"), ["sweep", str(PAPER), "--output", str(tmp_path), "--scheduler", "tcp://127.0.0.1:9"]
    )
    assert outcome.exit_code != 0
    assert "tcp://127.0.0.1:9" in str(outcome.exception)
