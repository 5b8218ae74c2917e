"""`hil.connect`: watch a running rig and command it, from Python."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.connection import _changes
from hil.live.runtime_paths import runtime_paths
from tests.support.live_rig import PAPER, Control, emulated
from tests.support.paths import ROOT


def test_a_rig_that_does_not_run_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("hil.connection.FIRST_S", 0.1)
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(hil.NoSidecarError, match="is `hil sidecar RIG`"):
        hil.connect("nobody", endpoint="tcp/127.0.0.1:1")


def test_changes_are_told_once_across_batches() -> None:
    last = {"fault": 0}
    told = []
    for first, states, faults in ((0, [2, 2, 3], [0, 0, 0]), (3, [3, 6, 6], [0, 4, 4]), (6, [6, 2, 2], [4, 4, 0])):
        stamps = (first + np.arange(3)) * 1_000_000
        columns = {"state": np.array(states), "fault": np.array(faults), "scheduled_ns": stamps}
        told += [(round(event.time * 1e3), event.text.split()[0]) for event in _changes(columns, last)]
    assert told == [(0, "state"), (2, "state"), (4, "fault"), (4, "state"), (7, "state")]


@pytest.mark.live
def test_a_live_rig_is_watched_and_commanded(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "hil", "sidecar", str(PAPER), "--listen", "tcp/127.0.0.1:7447", "--or-free-port"]
    with emulated(), Control() as control:
        sidecar = subprocess.Popen(
            [*words, "--out", str(tmp_path)], cwd=ROOT, env=os.environ, stdout=subprocess.DEVNULL
        )
        try:
            endpoint = runtime_paths("paper").endpoint
            until = time.monotonic() + 30.0
            while not endpoint.exists() and time.monotonic() < until:
                time.sleep(0.02)
            with hil.connect("paper", endpoint.read_text()) as rig:
                rig.wait_for("READY")
                with pytest.raises(ValueError, match="the commands are activate"):
                    rig.command("jump")
                events = rig.events()
                assert next(events).text == "state READY"
                verdict = rig.command("activate")
                assert verdict.accepted, json.dumps(verdict._asdict())
                assert next(events).text in ("state ACTIVE", "state HOMING")
                assert rig.status().axes == ["x", "y"]
                assert ("STATE", "CONNECTED -> READY") in [(event.kind.name, event.name) for event in rig.log()]
                columns = next(rig.telemetry())
                assert columns["force"].shape == (len(columns["index"]), 2)
                assert np.all(np.diff(columns["index"]) > 0)
                refused = rig.command("activate")
                assert (refused.accepted, bool(refused.reason)) == (False, True)
                assert rig.command("stop").accepted
                rig.wait_for("READY")
        finally:
            sidecar.terminate()
            sidecar.wait(20.0)
        assert control.process.poll() is None
