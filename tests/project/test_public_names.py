"""`import hil`: its names, what they do, and that they are loaded only when asked for."""

import subprocess
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import hil
from tests.support.paths import RIGS, ROOT
from tests.support.public_names import public_names, version

PAPER = RIGS / "paper.toml"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]
NO_NAME = "nothing"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[hil.Simulation, Path]:
    path = tmp_path_factory.mktemp("runs") / "run.mcap"
    return hil.simulate(PAPER, 0.6, overrides=QUICK, record=path), path


def test_each_public_name_says_what_it_is() -> None:
    assert len(hil.__all__) > 30
    for name in hil.__all__:
        public = getattr(hil, name)
        assert public.__doc__ or get_args(public) or hasattr(public, "__mypyc_attrs__"), (
            name
        )  # compiled, a class has lost its docstring
    with pytest.raises(AttributeError, match="module 'hil' has no attribute 'nothing'"):
        getattr(hil, NO_NAME)


def test_import_hil_loads_nothing_that_it_does_not_need() -> None:
    look = "import sys, hil; print(*sorted(m for m in sys.modules if m.partition('.')[0] in ('numpy', 'typer', 'hil')))"
    told = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout
    assert told.split() == ["hil"]
    law = "import sys; from hil import Law; assert not {'typer', 'rich', 'zenoh', 'can'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", law], check=True)


def test_a_simulation_is_that_of_hil_sim(recorded: tuple[hil.Simulation, Path]) -> None:
    from hil.rig.file import load_rig
    from hil.virtual.sim import simulate

    run, _ = recorded
    report, traces = simulate(load_rig(PAPER, QUICK), RIGS, 0.6)
    assert run.trace_sha256 == report.trace_sha256
    assert run.figures.axes == report.axes
    assert np.array_equal(run.force, traces.force)
    assert run.true is not None
    assert run.true.shape == run.measured.shape == (600, 2)
    assert run.time[-1] == pytest.approx(0.599)
    known = np.isfinite(run.error)
    assert known.any()
    assert np.allclose(run.measured[known] - run.setpoint[known], run.error[known], atol=1e-15)


def test_a_recording_gives_what_the_cycle_wrote_bit_for_bit(recorded: tuple[hil.Simulation, Path]) -> None:
    run, path = recorded
    read = hil.Recording(path)
    assert run.columns.keys() <= read.columns.keys()
    for name, values in run.columns.items():
        assert np.array_equal(values, read.columns[name], equal_nan=values.dtype.kind == "f"), name
    assert (read.truncated, read.lost, read.true) == (False, 0, None)
    assert read.events == run.events
    assert read.summary() == run.summary()
    assert read.compare(run) == {axis: {"setpoint": 0.0, "error": 0.0, "force": 0.0} for axis in ("x", "y")}
    assert hil.replay(path).different == 0


def test_events_and_states_tell_the_runs_story(recorded: tuple[hil.Simulation, Path]) -> None:
    run, _ = recorded
    states = [event.text for event in run.events]
    assert states == ["state READY", "state ACTIVE"]
    assert run.state[-1] == run.summary()["final_state"] == "ACTIVE"
    assert run.summary()["faults"] == []


def test_a_law_of_ones_own_that_fails_is_in_the_events(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "from hil import Law\n\n\nclass Own(Law):\n    def reset(self, position, force):\n        pass\n\n"
        "    def force(self, inputs):\n        return inputs.nothing\n"
    )
    (tmp_path / "rig.toml").write_text(PAPER.read_text())
    run = hil.simulate(hil.load_rig(tmp_path / "rig.toml"), 0.4, overrides=["law.name=./own.py:Own"])
    assert "own.py:9: AttributeError" in run.law_failure
    assert run.events[-1].text == "state FAULT"
    assert run.summary()["faults"] == ["NOT_FINITE"]


def test_rigs_are_changed_without_changing_the_first() -> None:
    rig = hil.load_rig(PAPER, ["law.name=pid"])
    other = rig.changed("task.radius=0.5", "law.name=robust-pd")
    assert (rig.config.law.name, rig.config.task.radius) == ("pid", 1.0)
    assert (other.config.law.name, other.config.task.radius) == ("robust-pd", 0.5)
    assert rig.sha256 != other.sha256
    assert rig.axes == ["x", "y"]
    with pytest.raises(hil.RigError, match="rate_hz"):
        rig.changed("rate_hz=0")


def test_a_rig_can_be_built_from_a_document() -> None:
    limits = {"position": [-1.0, 1.0], "speed": 1.0, "force": 1.0, "force_rate": 1e4, "following_error": 0.1}
    axis = {"encoder_resolution": 1e-7, "rated_force": 1.0, "limits": limits, "model": {"mass": 0.1}}
    document = {"name": "mine", "axes": {"x": axis}}
    rig = hil.Rig.build(document)
    assert document == {"name": "mine", "axes": {"x": axis}}
    run = hil.simulate(rig, 0.3)
    assert run.summary()["final_state"] == "ACTIVE"
    assert run.compare(hil.simulate(rig.changed(), 0.2))["x"]["force"] == 0.0
    with pytest.raises(ValueError, match="the axes x and x, y"):
        run.compare(hil.simulate(PAPER, 0.1))


def test_a_run_is_drawn_and_tabled(recorded: tuple[hil.Simulation, Path], tmp_path: Path) -> None:
    run, _ = recorded
    assert run.plot(tmp_path / "run.png").stat().st_size > 1000
    try:
        import pandas  # noqa: F401
    except ImportError:
        with pytest.raises(ImportError):
            run.to_pandas()
    else:
        table = run.to_pandas()
        assert table["x_force"].tolist() == run.force[:, 0].tolist()


NAMES_FOLDER = ROOT / "tests" / "project" / "names"


def kept(line: str, now: list[str]) -> bool:
    """Whether a name of an earlier version is as it was, or may be called as before: with parameters that have got a
    default, or with more behind them that have one.
    """
    head, call, parameters = line.partition("(")
    if not call:
        return line in now
    before = [part for part in parameters[:-1].split(", ") if part]
    for other in now:
        if other.startswith(head + "("):
            parts = [part for part in other[len(head) + 1 : -1].split(", ") if part]
            same = all(new == old or new.startswith(old + "=") for old, new in zip(before, parts, strict=False))
            return (
                same and len(parts) >= len(before) and all(new[0] == "*" or "=" in new for new in parts[len(before) :])
            )
    return False


def test_a_parameter_with_a_default_may_be_added_and_nothing_else() -> None:
    assert kept("f(a, b=1)", ["f(a, b=1, c=2)"])
    assert kept("f()", ["f(c=2)"])
    assert kept("f(a, b)", ["f(a, b=1)"])
    assert not any(kept("f(a, b=1)", [other]) for other in ("f(a, b=2)", "f(a, b=1, c)", "f(a)", "f", "g(a, b=1)"))


def test_the_names_of_this_version_are_written_down() -> None:
    """An added name: run `python -m tests.support.public_names`."""
    assert (NAMES_FOLDER / f"{version()}.txt").read_text().splitlines() == public_names()


def test_no_name_of_the_version_before_is_gone_unless_it_was_deprecated_there() -> None:
    """deprecated.txt: VERSION LINE, the version in which a name was first said to go."""
    files = sorted(NAMES_FOLDER.glob("[0-9]*.txt"), key=lambda file: [*map(int, file.stem.split("."))])
    assert files[-1].stem == version()
    now = public_names()
    rows = [line.split(" ", 1) for line in (NAMES_FOLDER / "deprecated.txt").read_text().splitlines()]
    announced = {line for since, line in rows if since in {file.stem for file in files[:-1]}}
    before = files[-2].read_text().splitlines()
    assert len(before) > 200
    assert [line for line in before if not kept(line, now) and line not in announced] == []
