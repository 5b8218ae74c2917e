"""Whoever reads a recording runs none of its code and reads none of the files it names; a replay that was asked to run
it does so where it can do no harm."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hil
from drivers.base.plugins import CodeRefusedError, find, only
from hil.rig import law_names
from hil.rig.file import build_rig
from hil.rig.schema import RigError
from hil.virtual.replay import exact_motion, replay_run
from hil.virtual.sandbox import ConfinedError, confined
from tests.support.paths import RIGS, ROOT

LAW = """
import os
from pathlib import Path
from hil import Law
for place in os.environ["MARK"].split(":"):
    try:
        Path(place).write_text("it ran")
    except OSError as error:
        print(error)

class Mine(Law):
    def __init__(self, model, period, force_limit):
        self.model = model
    def reset(self, position, force): pass
    def force(self, inputs):
        return self.model.gravity - 40.0 * (inputs.position_estimate - inputs.start.position)
"""
READING = (
    "runs --in .", "share R", "share R --with-code", "events R", "report R", "plot R", "export R -o x.csv",
    "export R -o x.npz", "diff R R", "recover R", "learnt R", "replay R", "replay R --law pid",
)  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With a recording whose law leaves a mark wherever it runs; the law's own file is gone, and so is its mark."""
    monkeypatch.setenv("MARK", str(tmp_path / "mark"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "law.py").write_text(f"{LAW}# {tmp_path}")  # each its own: one text is executed once a process
    (tmp_path / "rig.toml").write_text((RIGS / "paper.toml").read_text())
    sets = ["law.name=./law.py:Mine", "task.kind=hold"]
    hil.simulate(tmp_path / "rig.toml", 0.4, overrides=sets, record=tmp_path / "run.mcap")
    assert (tmp_path / "mark").read_text() == "it ran"
    (tmp_path / "mark").unlink()
    (tmp_path / "law.py").unlink()
    return tmp_path


def command(text: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    arguments = text.replace("R", str(folder / "run.mcap")).split()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", "hil", *arguments], capture_output=True, text=True, cwd=folder, env=environment
    )


@pytest.mark.requirement(id="SR-9.5")
@pytest.mark.long
@pytest.mark.parametrize("text", READING)
def test_a_reading_command_does_not_run_it(text: str, folder: Path) -> None:
    done = command(text, folder)
    assert "Traceback" not in done.stderr
    assert not (folder / "mark").exists()
    refused = text.startswith(("learnt", "replay"))
    assert (done.returncode != 0) == refused, done.stderr
    if refused:
        assert "law.name = './law.py:Mine'" in done.stderr
        assert "--run-its-code" in done.stderr or "--trust-its-code" in done.stderr


def test_reading_it_in_python_does_not_run_it(folder: Path) -> None:
    recording = hil.Recording(folder / "run.mcap")
    assert (len(recording.time), recording.exact) == (400, False)
    recording.summary(), recording.events, recording.report(folder / "x.html")
    with pytest.raises(RigError, match="came with the file, and is not run"):
        replay_run(folder / "run.mcap")
    assert not (folder / "mark").exists()


@pytest.mark.long
def test_a_replay_that_was_asked_runs_it_where_it_cannot_write(folder: Path) -> None:
    done = command("replay R --run-its-code", folder)
    assert done.returncode == 0, done.stderr
    assert "every torque frame is the same" in done.stdout
    assert "runs law.name = './law.py:Mine' (sha256:" in done.stderr
    assert not (folder / "mark").exists()
    assert command("replay R", folder).returncode == 1  # it was asked once


@pytest.mark.long
def test_code_that_was_trusted_needs_no_asking_and_other_code_does(folder: Path) -> None:
    assert command("replay R --trust-its-code", folder).returncode == 0
    assert command("replay R --json x.json", folder).returncode == 0
    assert json.loads((folder / "x.json").read_text())["ticks"] == 400
    assert command("events R", folder).returncode == 0
    (folder / "config" / "hil" / "trusted-code").chmod(0o666)  # anybody may have written to it
    assert command("replay R", folder).returncode == 1
    assert not (folder / "mark").exists()


@pytest.mark.long
def test_the_readers_own_law_runs_beside_a_recording_of_ours(folder: Path) -> None:
    hil.simulate(folder / "rig.toml", 0.3, record=folder / "ours.mcap")
    (folder / "mine.py").write_text(LAW)
    done = command(f"replay {folder}/ours.mcap --law {folder}/mine.py:Mine", folder)
    assert done.returncode == 0, done.stderr
    assert (folder / "mark").exists()


HARMFUL: dict[str, Callable[[Path], Any]] = {
    "write": lambda place: place.write_text("x"),
    "append": lambda place: (place / "../kept").open("a"),
    "truncate": lambda place: os.truncate(place.parent / "kept", 0),
    "delete": lambda place: os.unlink(place.parent / "kept"),
    "rename": lambda place: os.rename(place.parent / "kept", place),
    "folder": lambda place: os.mkdir(place),
    "link": lambda place: os.symlink("kept", place),
    "mode": lambda place: os.chmod(place.parent / "kept", 0o777),
    "pipe": lambda place: os.mkfifo(place),
    "network": lambda place: __import__("socket").socket(),
    "program": lambda place: os.execv("/bin/true", ["true"]),
    "fork": lambda place: os.fork() or os._exit(0),
    "kill": lambda place: os.kill(os.getppid(), 0),
    "memory of another": lambda place: os.open(f"/proc/{os.getppid()}/mem", os.O_RDWR),
    "shared memory": lambda place: os.memfd_create("x"),
    "limits": lambda place: __import__("resource").prlimit(os.getppid(), 7, (1, 1)),
}


@pytest.mark.parametrize("harm", HARMFUL)
def test_in_a_confined_process_it_is_refused(harm: str, tmp_path: Path) -> None:
    tmp_path = tmp_path / "own"
    tmp_path.mkdir()
    (tmp_path / "kept").write_text("kept")
    (tmp_path / "kept").chmod(0o600)

    def work(confine: Callable[[], None]) -> str:
        confine()
        try:
            HARMFUL[harm](tmp_path / "made")
        except OSError as error:
            return type(error).__name__
        return "it could"

    assert confined(work) == "PermissionError"
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
    assert ((tmp_path / "kept").read_text(), (tmp_path / "kept").stat().st_mode & 0o777) == ("kept", 0o600)


def test_what_a_confined_process_answers_is_data() -> None:
    assert confined(lambda confine: {"a": [1.5, None]}) == {"a": [1.5, None]}
    with pytest.raises(ConfinedError, match=r"^no \?\[31m way$"):
        confined(lambda confine: json.loads("no \x1b[31m way") if False else _raise("no \x1b[31m way"))
    with pytest.raises(ConfinedError, match="status 7 and no answer"):
        confined(lambda confine: os._exit(7))


def _raise(text: str) -> None:
    raise ValueError(text)


@pytest.mark.requirement(id="SR-9.5")
@pytest.mark.parametrize(
    "change",
    [
        {"law": {"name": "./law.py:Mine", "source": ""}},
        {"law": {"name": "antigravity:Law"}},
        {"bus": {"protocol": "dbc:/etc/hostname"}},
        {"bus": {"protocol": "cia402", "cia402": {"eds": ["/etc/hostname"]}}},
        {"bus": {"protocol": "./law.py:Layout", "source": LAW}},
        {"estimator": {"name": "./law.py:Estimator", "source": LAW}},
        {"task": {"kind": "path", "file": "/etc/hostname"}},
        {"task": {"kind": "./law.py:Task", "source": LAW, "axes": ["x"]}},
        {"law": {"learnt": "/etc/hostname", "iterative_learning": True}},
    ],
)
def test_no_file_of_the_reader_is_read_because_a_recording_names_it(
    change: dict[str, dict[str, Any]], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    document = hil.load_rig("paper").config.model_dump(mode="json")
    for table, keys in change.items():
        document[table] |= keys

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and str(arguments[0]).startswith(("/etc/hostname", str(folder))):
            opened.append(str(arguments[0]))

    hooks.append(hook)
    try:
        with only(()):
            build_rig(document, carried=True)
    except RigError:
        pass
    finally:
        hooks.remove(hook)
    assert opened == []
    assert "antigravity" not in sys.modules
    assert not (folder / "mark").exists()


hooks: list[Callable[[str, tuple[Any, ...]], None]] = []  # an audit hook cannot be taken away again
sys.addaudithook(lambda event, arguments: [hook(event, arguments) for hook in hooks] and None)


def test_where_only_some_code_is_permitted_the_rest_is_not_even_imported() -> None:
    with only(["sha256:of another"]), pytest.raises(CodeRefusedError, match=r"law\.name = 'antigravity:Law'"):
        find(law_names.KIND, "antigravity:Law")
    assert "antigravity" not in sys.modules
    with only(()):
        assert find(law_names.KIND, "pid").__name__ == "Pid"


def test_what_cannot_be_run_again_keeps_its_rounded_values(folder: Path) -> None:
    assert exact_motion(folder / "run.mcap") is None
