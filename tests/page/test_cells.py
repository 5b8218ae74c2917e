"""The page's dish: places from the rig, and the newest word on each cell of this run, from the sidecar."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from websockets.sync.client import connect
from websockets.typing import Origin

from hil.control.motion.injection.verdict import Verdict
from hil.page.access import Role
from hil.page.rig_facts import cell_places
from hil.page.server import STATIC
from hil.page.sidecar_feed import SidecarFeed
from hil.rig.bus_load import rig_layout
from hil.rig.file import load_rig
from hil.studies.inject.equipment import grid, middle, words
from hil.telemetry import telemetry_pb2 as pb
from tests.support.cells import equipped
from tests.support.page_process import PageProcess
from tests.support.paths import RIGS, ROOT
from tests.telemetry.test_sidecar import free_endpoint

RIG = RIGS / "microscope-ideal.toml"
PATIENCE_S = 60.0


def cell(number: int, index: int, run: int = 1, **more: object) -> pb.Cell:
    return pb.Cell(number=number, of=3, index=index, run=run, **more)  # type: ignore[arg-type]


def test_the_places_of_the_cells_are_those_of_the_rig() -> None:
    rig = equipped(3)
    assert cell_places(rig.model_dump(mode="json")) == [list(row[:2]) for row in rig.motion.parameters["cells"]]
    assert cell_places(load_rig(RIG).model_dump(mode="json")) == []


def test_a_viewer_gets_the_newest_word_on_each_cell_of_this_run_and_then_the_news() -> None:
    with SidecarFeed("nobody") as feed:
        feed._keep_cells([cell(1, 5, verdict="no_cell", began=1.0, ended=2.5), cell(2, 9, phase="seek"), cell(1, 2)])
        feed._keep_cells([cell(3, 1, run=2, verdict="ok")])
        news, found = feed.cells(1)
        assert [(each["number"], each["verdict"], each["phase"]) for each in found] == [
            (1, "no cell", ""),
            (2, "", "seek"),
        ]
        assert found[0]["seconds"] == 1.5
        assert feed.cells(1, news) == (news, [])
        feed._keep_cells([cell(2, 12, verdict="ok", peak_force=float("nan"))])
        assert [(each["verdict"], each["peak"]) for each in feed.cells(1, news)[1]] == [("ok", None)]


def test_the_page_has_a_colour_for_every_verdict() -> None:
    text = (STATIC / "cells.js").read_text()
    hues = text[text.index("HUES = {") : text.index("};")].replace('"', "")
    names = {verdict.name.lower().replace("_", " ") for verdict in Verdict if verdict}
    assert [name for name in sorted(names) if f"{name}:" not in hues] == []


@pytest.mark.live
def test_who_opens_the_page_late_sees_the_cells_that_are_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runtime = tmp_path / "run"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(runtime))
    rig = load_rig(RIG)
    chosen = words(rig, grid(1, 3, 1e-3, middle(rig)), 3, 0.0, ("", "no_cell", ""), fd=rig_layout(rig, RIGS).fd)
    commands = (
        [sys.executable, "-m", "tests.support.shown_rig", str(RIG), *chosen],
        [
            sys.executable,
            "-m",
            "hil",
            "sidecar",
            str(RIG),
            "--listen",
            free_endpoint(),
            "--out",
            str(tmp_path / "runs"),
        ],
    )
    children = [subprocess.Popen(command, cwd=ROOT, env=dict(os.environ)) for command in commands]
    try:
        with PageProcess(tmp_path / "state", "microscope-ideal") as page:
            page.pair(Role.WATCH, "Ana")
            until = time.monotonic() + PATIENCE_S
            seen: dict[int, str] = {}
            while seen.get(2) != "no cell":  # each time as somebody who has just come
                assert time.monotonic() < until, seen
                seen = joined(page, 1.0)
            assert seen[1] == "ok"
    finally:
        for child in children:
            child.send_signal(signal.SIGTERM)
            child.wait(PATIENCE_S)


def joined(page: PageProcess, seconds: float) -> dict[int, str]:
    """The verdicts that somebody hears in the first seconds."""
    found: dict[int, str] = {}
    address = f"ws://localhost:{page.port}/rigs/microscope-ideal/feed"
    headers = {"Cookie": page.cookie}
    with connect(address, origin=Origin(page.url), additional_headers=headers, proxy=None) as feed:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            message = feed.recv(5.0)
            if isinstance(message, str):
                found |= {each["number"]: each["verdict"] for each in json.loads(message).get("cells", [])}
    return found
