"""A filter's design is made once and cached for the next process, which trusts what nobody else can have written."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.control.estimator import gains_cache
from hil.control.estimator.gains import design_gains
from hil.control.estimator.gains_cache import load, store
from hil.rig.schema import RigConfig
from tests.support.paths import ROOT

PARAMETERS = json.dumps([{"mass": 0.5, "period": 1e-3}])
DESIGN = [[[0.9, 1000.0, -3e5], 7e-15]]
RIG = ROOT / "deploy" / "rigs" / "paper.toml"

# what a control process does at its start; afterwards no child could be started any more
START = """
import json, sys
from pathlib import Path
from hil.rig.file import load_rig
from hil.control.estimator.gains import design_gains
if sys.argv[2] == "no child":
    sys.executable = "/nonexistent"
gains, variance = design_gains(load_rig(Path(sys.argv[1])))
assert "filterpy" not in sys.modules
print(json.dumps([gains.tolist(), variance.tolist()]))
"""


@pytest.fixture(autouse=True)
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "hil" / "designs"


def only_file(directory: Path) -> Path:
    (path,) = directory.iterdir()
    return path


def start(child: str) -> str:
    words = [sys.executable, "-c", START, str(RIG), child]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout


@pytest.mark.long
def test_the_second_process_has_the_first_ones_design(paper: RigConfig, directory: Path) -> None:
    first = start("a child")
    assert only_file(directory).stat().st_mode & 0o077 == 0
    assert start("no child") == first
    gains, variance = design_gains(paper)  # by filterpy, here
    assert json.loads(first) == [gains.tolist(), variance.tolist()]


LOWEST_RATE = """
import sys
from pathlib import Path
from hil.analysis.stability import check_stability
from hil.rig.file import load_rig
report = check_stability(load_rig(Path(sys.argv[1])), lowest_rate=True)
print([axis.lowest_stable_rate_hz for axis in report.axes.values()], "filterpy" in sys.modules)
"""


@pytest.mark.long
def test_who_asks_for_lowest_rates_again_needs_no_filterpy(directory: Path) -> None:
    """Every rate tried needs a filter of its own: filterpy is loaded for all of them once, and then for none."""
    words = [sys.executable, "-c", LOWEST_RATE, str(RIG)]
    first, second = (subprocess.run(words, capture_output=True, text=True, check=True).stdout.split("]") for _ in "12")
    assert first[1].split() == ["True"]
    assert second == [first[0], " False\n"]
    assert len(list(directory.iterdir())) > 1


def test_an_entry_serves_the_same_parameters_alone() -> None:
    assert load(PARAMETERS) is None
    store(PARAMETERS, DESIGN)
    assert load(PARAMETERS) == DESIGN
    assert load(json.dumps([{"mass": 0.50000001, "period": 1e-3}])) is None


def test_other_code_or_packages_make_another_design(monkeypatch: pytest.MonkeyPatch) -> None:
    store(PARAMETERS, DESIGN)
    assert load(PARAMETERS) is not None
    monkeypatch.setattr(gains_cache, "version", lambda name: "0")
    assert load(PARAMETERS) is None


@pytest.mark.long
@given(st.integers(0, 10**6), st.integers(1, 255))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_file_is_no_design(directory: Path, place: int, change: int) -> None:
    store(PARAMETERS, DESIGN)
    path = only_file(directory)
    content = bytearray(path.read_bytes())
    content[place % len(content)] ^= change
    path.write_bytes(content)
    assert load(PARAMETERS) is None
    path.write_bytes(content[: place % len(content)])
    assert load(PARAMETERS) is None


def test_where_others_may_write_nothing_is_read_or_stored(directory: Path) -> None:
    store(PARAMETERS, DESIGN)
    directory.chmod(0o770)
    assert load(PARAMETERS) is None
    only_file(directory).unlink()
    store(PARAMETERS, DESIGN)
    assert list(directory.iterdir()) == []


def test_a_link_to_another_directory_is_not_followed(directory: Path, tmp_path: Path) -> None:
    directory.parent.mkdir(parents=True)
    directory.symlink_to(tmp_path)
    store(PARAMETERS, DESIGN)
    assert load(PARAMETERS) is None
    assert not list(tmp_path.glob("*.json"))


def test_where_nothing_can_be_stored_nothing_fails(directory: Path) -> None:
    directory.parent.parent.write_text("a file in its place")
    store(PARAMETERS, DESIGN)
    assert load(PARAMETERS) is None


def test_a_service_keeps_it_in_the_directory_systemd_gives_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "service"))
    store(PARAMETERS, DESIGN)
    assert load(PARAMETERS) == DESIGN
    assert only_file(tmp_path / "service" / "designs")


def test_the_oldest_go(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gains_cache, "MAX_ENTRIES", 3)
    for number in range(5):
        store(json.dumps([{"mass": number + 1.0}]), DESIGN)
        for path in directory.iterdir():
            os.utime(path, ns=(0, path.stat().st_mtime_ns - 10**9))  # all the others are older
    cached = [load(json.dumps([{"mass": number + 1.0}])) is not None for number in range(5)]
    assert cached == [False, False, True, True, True]
