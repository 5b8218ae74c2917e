"""`hil camera` beside an emulated stage and a control process: what it draws and sees is in the ring."""

import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hil.camera.calibration import View, calibrated, keep, stage_of
from hil.camera.contract import Seen, Spot
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import runtime_paths
from tests.camera.rigs import CAMERA, RIG, camera_rig

PATIENCE_S = 60.0
# What is tested is the camera, not punctuality: the rig stays CONNECTED or READY, whatever the host does.
CALM = (
    "name=camera-live", "rate_hz=250", "bus.interface=local", "timing.realtime=false", "timing.lock_memory=false",
    "timing.dma_latency=false", "timing.allow_degraded=true", "drives.watchdog_s=1.0",
    "law.name=pd-feedforward", "law.gains={kp=[200.0, 150.0, 100.0, 0.01], kd=[20.0, 15.0, 8.0, 0.001]}",
    "safety.overrun_zero_s=3.0", "safety.overrun_streak=1000", "safety.silent_stop_ticks=1000",
    "safety.silent_zero_ticks=1000", "safety.flood_frames=1000",
)  # fmt: skip
WORDS = [word for override in (*CAMERA, *CALM) for word in ("--set", override)]


@contextmanager
def running(*words: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", *words, *WORDS], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        yield process
    finally:
        process.terminate()
        process.communicate()


def said(process: subprocess.Popen[str], words: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if words in line:
            return
    raise AssertionError(f"{process.args!r} ended without saying {words!r}")


def ring(path: Path) -> RingReader:
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            return RingReader(path)
        except RingError:
            assert time.monotonic() < end
            time.sleep(0.05)


def straight() -> Sequence[View]:
    """As the drawn camera has it: it goes with the pipette, which stands in the middle."""
    ways = [(0.0, 0.0), (1e-4, 0.0), (0.0, 1e-4), (-1e-4, 0.0), (0.0, -1e-4)]
    return [View(way, Seen(Spot(319.5, 239.5), 1.0, Spot(-way[0] / 2.5e-6, -way[1] / 2.5e-6))) for way in ways]


@pytest.mark.live
@pytest.mark.long
def test_what_the_drawn_camera_sees_comes_to_the_control_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(runtime))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    rig = camera_rig(*CALM)
    keep(rig, calibrated(straight(), stage_of(rig, (480, 640)), time.time()))
    with running("emulate", str(RIG), "--camera") as emulator:
        said(emulator, "status in")
        with running("run", str(RIG)) as control, ring(runtime_paths(rig.name).ring) as reader:
            done = subprocess.run(
                [sys.executable, "-m", "hil", "camera", str(RIG), "--source", "drawn", "--seconds", "5", *WORDS],
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            assert control.poll() is None
            found = re.search(r"(\d+) images, \d+ that were there before; seen: tip_error in (\d+)", done.stdout)
            assert found is not None, done.stdout
            images, tips = int(found[1]), int(found[2])
            assert images >= 5
            assert tips >= 1
            reader.next = max(reader.written - 10, 0)
            record = reader.read(10).records[-1]
            tip, shift, bolus = record["readings"][:3].tolist()
            assert abs(tip) < 5e-6
            assert np.isfinite(shift)
            assert bolus == 0.0
            assert int(record["rejects"].sum()) == 0
