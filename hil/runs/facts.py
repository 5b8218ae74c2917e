"""What a list of runs says of one: rig, law, how it ended, accuracy; read from its recording, which is data.

No code that a recording carries is run, and no file that it names is read (hil.rig.provenance.rig_of_run).
"""

import os
from typing import Any

from drivers.base.text_file import words_of
from drivers.base.toml_file import short
from hil.runs.kept import KeptRun

LARGEST = 200_000_000  # bytes: about half an hour of four axes at 1 kHz, which takes a minute and 1 GB to sum up
OUTCOMES = ("sound", "fault", "estop", "unread")
_STOPS = {"FAULT": "fault", "ESTOP": "estop"}


def unread(problem: str) -> dict[str, Any]:
    """The facts of a run that cannot be read; the same keys as those of any other."""
    return {
        "outcome": "unread",
        "problem": short(problem, 200),
        "rig": "",
        "rig_hash": "",
        "law": "",
        "clock": "",
        "seconds": 0.0,
        "state": "",
        "fault": "",
        "missing": "",
        "settled": True,
        "quota": 0,
        "axes": {},
    }


def facts_of(run: KeptRun) -> tuple[dict[str, Any], bool]:
    """(facts of the run, whether they hold as long as its files stay as they are). Never raises for its content.

    clock: live or virtual. seconds: s from first to last tick. state, fault: at its end. missing: lost ticks, in
    words. settled: whether the window of the figures is steady. quota: the rig's telemetry.record_quota, bytes. axes:
    by name kind (linear, rotary), rms_error and max_error of that window, m (rad), NaN where there is none.
    """
    if run.problem:
        return unread(run.problem), False
    if closed := next((path for path in run.files if not os.access(path, os.R_OK)), None):
        return unread(f"{closed.name}: may not be read"), False
    if run.size > LARGEST:
        size = f"{run.size / 1e6:.0f} MB, more than the {LARGEST / 1e6:.0f} MB that a list reads"
        return unread(f"{size}: hil report {run.path}"), True
    from hil.runs.summary import load_run, summarise  # with the readers of recordings, of which a full index needs none

    try:
        data = load_run(run.first)
        summary = summarise(data)
    except Exception as error:  # whatever its author put into it: one run does not hide the others
        text = "; ".join(getattr(error, "problems", [])) or words_of(error)
        return unread(text.replace(f"{run.first}: ", "")), True
    axes = {
        name: {"kind": data.rig.axes[name].kind, "rms_error": row["rms_error"], "max_error": row["max_error"]}
        for name, row in summary["axes"].items()
    }
    state = summary["final_state"] or ""
    return {
        "outcome": _STOPS.get(state, "sound"),
        "problem": "",
        "rig": data.rig.name,
        "rig_hash": summary["rig_hash"],
        "law": data.rig.law.name,
        "clock": "virtual" if summary["realtime"] == "lockstep" else "live",
        "seconds": summary["seconds"],
        "state": state,
        "fault": _fault_at_end(data),
        "missing": summary["recording"]["loss"],
        "settled": summary["settled"],
        "quota": data.rig.telemetry.record_quota,
        "axes": axes,
    }, True


def _fault_at_end(data: Any) -> str:
    from hil.cycle.fault_table import Fault

    at_end = int(data.columns["fault"][-1]) if len(data.columns["fault"]) else 0
    return Fault(at_end).name if at_end else ""
