"""Runs drawn cases in virtual time, and has each told from its events alone."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.sim import simulate
from tests.sealed.draw import Case
from tests.sealed.reader import Answer, read
from tests.support.paths import RIGS


def run_case(case: Case, folder: Path) -> None:
    """The run as `hil sim --out FOLDER` leaves it: a recording that says nothing of what was injected."""
    folder.mkdir()
    rig = case.config
    recorder = LockstepRecorder(folder / "run.mcap", rig, RIGS / f"{case.rig}.toml")
    try:
        simulate(rig, RIGS, case.seconds, observer=recorder.observe, scenario=case.scenario, tell=recorder.tell)
    finally:
        recorder.close()


def answers(cases: Sequence[Case], folder: Path) -> list[Answer]:
    """Run all of them; what each run's events say, to whom knows nothing else. Recordings are removed again."""
    found = []
    for number, case in enumerate(cases):
        where = folder / f"{number:03}"
        run_case(case, where)
        found.append(read(where))
        shutil.rmtree(where)
        print(f"{number}: {found[-1].line or 'nothing happened'}", flush=True)
    return found
