"""What the documents say exists, exists, and is what it says. Paths named in them are held by test_house.py."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from hil.cli.app import COMMANDS
from hil.operate.bench.command import BENCHES as AT_A_RIG
from hil.rig.shipped import names
from tests.benchmarks.__main__ import BENCHES
from tests.support.paths import ROOT

README = (ROOT / "README.md").read_text()
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
MAKEFILES = [ROOT / "Makefile", *ROOT.glob("deploy/*.mk"), *ROOT.glob("deploy/*/*.mk")]
TARGETS = {name for path in MAKEFILES for name in re.findall(r"^([a-z-]+):", path.read_text(), re.M)}
every_document = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))


def shown(document: Path) -> list[str]:
    """Commands as they are shown: in inline code, and on lines of their own in blocks."""
    found = re.findall(r"`([^`\n]+)`|^ {0,4}((?:hil|make) .*)$", document.read_text(), re.M)
    return [inline or line for inline, line in found]


def test_the_subscriber_shown_is_the_one_that_is_tested() -> None:
    assert (ROOT / "deploy" / "examples" / "subscribe.py").read_text() in (ROOT / "docs" / "recording.md").read_text()


@every_document
def test_every_link_leads_somewhere(document: Path) -> None:
    targets = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", document.read_text())
    assert [target for target in targets if "://" not in target and not (document.parent / target).exists()] == []


@every_document
def test_every_command_shown_exists(document: Path) -> None:
    words = [match[1] for code in shown(document) if (match := re.match(r"(?:\S*/)?hil ([a-z]+)\b", code))]
    known = {name for group in COMMANDS.values() for name in group}
    assert [word for word in words if word not in known] == []


@every_document
def test_every_target_of_make_shown_exists(document: Path) -> None:
    words = [match[1] for code in shown(document) if (match := re.match(r"make ([a-z-]+)", code))]
    assert [word for word in words if word not in TARGETS] == []


@every_document
def test_every_benchmark_shown_exists(document: Path) -> None:
    text = document.read_text()
    assert set(re.findall(r"make (?:bench|bench-compiled|counted) ARGS=\"?([a-z]+)", text)) <= set(BENCHES)
    assert set(re.findall(r"`hil bench ([a-z]+)", text)) <= set(AT_A_RIG)


@every_document
def test_every_rig_and_scenario_shown_by_name_is_shipped(document: Path) -> None:
    text = document.read_text()
    known = {*names("rigs"), "RIG"}
    rigs = re.findall(r"`hil (?:sim|compare|check|tune|sweep) (\w[\w-]*)(?![\w./-])", text)
    assert [rig for rig in rigs if rig not in known] == []
    assert set(re.findall(r"--faults ([\w-]+)(?![\w./-])", text)) <= set(names("scenarios"))


def test_the_two_commands_a_newcomer_needs_are_shown_first() -> None:
    assert re.findall(r"^make ([a-z]+)", README, re.M)[:2] == ["run", "test"]


@pytest.mark.long
def test_the_program_shown_runs_and_shows_what_it_promises(tmp_path: Path) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    first, second = (float(value) for value in re.findall(r"at most ([\d.]+) um on X", done.stdout))
    assert first > 100.0 * second  # the paper's law, and one that copes
    assert {path.name for path in tmp_path.glob("*.html")} == {"pd-feedforward.html", "structured-kalman.html"}
