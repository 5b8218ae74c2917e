"""The acceptance of a law, step by step, each with a verdict. Nothing here prints."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from hil.analysis.stability import check_stability
from hil.cli.output import metres
from hil.control.gain import declared
from hil.control.law_registry import law_class
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.rig.shipped import by_name
from hil.studies.acceptance.law_cost import law_cost
from hil.virtual.sim import simulate, usable

TASK_S = 4.0  # of virtual time
SAME_S = 1.0
MOST_GROWTH = 8.0  # bytes a tick: a float kept in every one; at 1 kHz half a gigabyte a day
PATIENCE_S = 600.0  # for a process of our own


class Finding(NamedTuple):
    """One step of the acceptance. passed: None where it could not be tried, for what the text says."""

    step: str
    passed: bool | None
    text: str


class Demand(NamedTuple):
    """What a law must hold. gain_db, phase_deg: margins of every axis, as `hil tune` demands them. period_share: of the
    period, that the slowest tick may take; the rest is for the cycle, the bus and what the machine does. stride: of the
    fault campaign's cells, every so many.
    """

    gain_db: float = 6.0
    phase_deg: float = 30.0
    period_share: float = 0.5
    stride: int = 20


class _Candidate(NamedTuple):
    rig: RigConfig
    rig_file: Path
    overrides: tuple[str, ...]
    demand: Demand

    @property
    def words(self) -> list[str]:
        """As arguments of a command."""
        return [str(self.rig_file), *(word for text in self.overrides for word in ("--set", text))]


_USUAL = Demand()


def accept_law(
    rig_file: str | os.PathLike[str], overrides: Sequence[str] = (), demand: Demand = _USUAL
) -> Iterator[Finding]:
    """Try the rig's law (name it by an override, law.name=...) in every way that needs no stage; a finding a step. An
    estimator of users (estimator.name=...) is tried with it.

    contract: the class, its gains, and that a run of it begins. task: the rig's own for TASK_S of virtual time.
    time: the slowest tick against the period, on this machine. memory: nothing kept by the tick. bytes: the same in
    two processes. margins: of the law as it is, by a pulse on each axis' measurement. faults: a slice of the
    fault campaign, in processes of its own. Raises RigError where the rig itself cannot be used.
    """
    path = by_name("rigs", Path(rig_file))
    rig = load_rig(path, overrides)
    try:
        made = law_class(rig.law)
        gains = ", ".join(declared(made.GAINS)) or "none"
        usable(rig, path)
    except (RigError, ValueError) as error:
        yield Finding("contract", False, str(error))
        return
    whole = ", all axes at once" if made.coupled else ""
    behind = f"; behind {rig.estimator.name}" if rig.estimator.is_users else ""
    yield Finding("contract", True, f"{made.__name__}{whole}; gains: {gains}{behind}")
    law = _Candidate(rig, path, tuple(overrides), demand)
    task = _task(law)
    yield task
    steps: dict[str, Callable[[_Candidate], Finding]] = {
        "time and memory": _cost, "bytes": _bytes, "margins": _margins, "faults": _faults,
    }  # fmt: skip
    for name, step in steps.items():
        yield step(law) if task.passed else Finding(name, None, "the task failed")


def _task(law: _Candidate) -> Finding:
    report, _ = simulate(law.rig, law.rig_file.parent, TASK_S)
    if report.law_failure:
        return Finding("task", False, f"{report.law_failure}; ended {report.state} with zero torque")
    if report.faults or report.state != "ACTIVE":
        why = report.latched.line if report.latched else f"faults: {', '.join(report.faults) or 'none'}"
        return Finding("task", False, f"ended {report.state}; {why}")
    kinds = {name: axis.kind for name, axis in law.rig.axes.items()}
    errors = (f"{name} {metres(row['max_error'], kinds[name])}" for name, row in report.axes.items())
    return Finding("task", True, f"{TASK_S:g} s, error at most {', '.join(errors)}")


def _cost(law: _Candidate) -> Finding:
    period = law.rig.period_ns * 1e-9
    allowed = law.demand.period_share * period
    cost = law_cost(law.rig, law.rig_file.parent, allowed)
    text = (
        f"slowest tick {cost.worst * 1e6:.0f} us, half of them {cost.median * 1e6:.0f} us, of a period of "
        f"{period * 1e6:.0f} us; keeps {cost.grows:.1f} bytes a tick"
    )
    problems = []
    if cost.worst > allowed:
        problems.append(f"more than {law.demand.period_share:.0%} of the period")
    if cost.grows >= MOST_GROWTH:
        problems.append("memory that grows for ever")
    return Finding("time and memory", not problems, "; ".join([text, *problems]))


def _bytes(law: _Candidate) -> Finding:
    hashes = []
    for seed in ("1", "2"):  # of Python's hashes: sets and dictionaries of words come in another order
        words = ["sim", *law.words, "--no-keep", "--seconds", f"{SAME_S:g}", "--json", "-"]
        done = _hil(words, {"PYTHONHASHSEED": seed})
        if done.returncode:
            return Finding("bytes", False, f"a process of its own failed: {_last_line(done.stderr)}")
        hashes.append(json.loads(done.stdout)["trace_sha256"])
    same = hashes[0] == hashes[1]
    text = f"trace_sha256 {hashes[0][:16]}... in two processes" if same else "another trace in each process"
    return Finding("bytes", same, text)


def _margins(law: _Candidate) -> Finding:
    try:
        report = check_stability(law.rig)
    except ValueError as error:
        return Finding("margins", False, f"on arrays the law fails, so that no margin is known: {error}")
    rows = {name: (axis.gain_db, axis.phase_deg) for name, axis in report.axes.items()}
    gain_db, phase_deg = law.demand.gain_db, law.demand.phase_deg
    weak = not report.stable or any(db < gain_db or degrees < phase_deg for db, degrees in rows.values())
    texts = [
        f"{name} {db:.1f} dB, {degrees:.0f} deg" if report.axes[name].stable else f"{name} unstable"
        for name, (db, degrees) in rows.items()
    ]
    wanted = f"; wanted {gain_db:g} dB, {phase_deg:g} deg: other gains, by hand or by hil tune"
    return Finding("margins", not weak, "; ".join(texts) + wanted * weak)


def _faults(law: _Candidate) -> Finding:
    done = _hil(["faults", *law.words, "--stride", str(law.demand.stride), "--json", "-"])
    try:
        document = json.loads(done.stdout)
    except ValueError:
        return Finding("faults", False, f"the campaign failed: {_last_line(done.stderr)}")
    text = f"{document['passed']} of {document['cells']} cells passed"
    return Finding("faults", document["passed"] == document["cells"] > 0, text)


def _hil(words: Sequence[str], environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """A command of hil in a process of its own: what a law does to its interpreter stays there."""
    command = [sys.executable, "-m", "hil", *words]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE_S, env={**os.environ, **(environment or {})}
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 1, "", f"no end within {PATIENCE_S:g} s")


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or ["it said nothing"])[-1]
