"""A live rig takes another law through its sidecar, at rest and under torque; its recording replays."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest
from typer.testing import CliRunner

import hil
from hil.cli.app import build_app
from hil.connection import Verdict
from hil.telemetry.recording import Recording
from hil.virtual.replay import loaded_documents, replay_run
from tests.support.live_rig import PAPER, PATIENCE_S
from tests.support.remote_rig import remote_rig

T = TypeVar("T")
pytestmark = pytest.mark.live


def again(ask: Callable[[], T], text: Callable[[T], str]) -> T:
    """What comes of it; asked once more where a busy computer let the request expire on its way."""
    until = time.monotonic() + PATIENCE_S
    while "stale: expired" in text(answer := ask()) and time.monotonic() < until:
        pass
    return answer


def verdict(ask: Callable[[], Verdict]) -> Verdict:
    return again(ask, lambda answer: answer.reason)


def test_gains_are_changed_at_rest_and_under_torque_and_the_recording_replays(tmp_path: Path) -> None:
    runner = CliRunner(env={"COLUMNS": "300"})
    with (
        remote_rig(tmp_path) as remote,
        hil.connect("paper", remote.endpoint, commands=remote.commands, credentials=remote.made / "operator") as rig,
    ):
        refused = verdict(lambda: rig.set_law({"name": "pd-feedforward"}, gains={"kp": 1e9, "kd": 1.0}))
        assert "law 'pd-feedforward' is unstable on axis 'x'" in refused.reason
        words = ["command", str(PAPER), "set-law", "--set", "law.gains={kp=[1800.0, 1800.0], kd=[60.0, 60.0]}"]
        done = again(lambda: runner.invoke(build_app("command"), words), lambda answer: answer.output)
        assert "set-law: accepted" in done.output, done.output
        assert verdict(lambda: rig.command("activate_hold")).accepted
        rig.wait_for("ACTIVE", PATIENCE_S)
        with rig.motion(take=True):  # once it holds
            assert verdict(lambda: rig.set_law(gains={"kp": [2200.0, 2200.0], "kd": [70.0, 70.0]})).reason == ""
        assert rig.status().fault == "NONE"
        recording, until = tmp_path / "out" / "run.mcap", time.monotonic() + PATIENCE_S
        while len(found := loaded_documents(Recording(recording))) < 2:  # the sidecar writes every half second
            assert time.monotonic() < until
            rig.status()
    assert [("2200" in text, "1800" in text) for text in found.values()] == [(False, True), (True, False)]
    report = replay_run(recording)
    assert report.ticks > 100
    assert report.different == 0
