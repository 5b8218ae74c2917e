"""The table of `make peers`: what differs is explained, or the lane fails."""

import json
from pathlib import Path

import pytest

from tests.peers.sources import pinned
from tests.peers.table import (
    DIFFERS,
    NOT_RUN,
    PASSED,
    Deviation,
    Row,
    attributed,
    deviations,
    summary,
    unexplained,
    write,
)
from tests.support.paths import ROOT

ROWS = [
    Row("peer", "test_a", PASSED, own=True),
    Row("peer", "test_b[1]", DIFFERS, "2 != 1"),
    Row("peer", "test_c", DIFFERS, "3 != 1"),
    Row("other", "test_b[1]", DIFFERS, "4 != 1"),
    Row("other", "all", NOT_RUN, "no answer"),
]
KNOWN = [Deviation("peer", ["test_b*"], "theirs", "they count from 2")]


def test_a_difference_is_explained_by_peer_and_pattern_and_nothing_else_is() -> None:
    rows = attributed(ROWS, KNOWN)
    assert [(row.fault, row.why) for row in rows] == [("", ""), ("theirs", "they count from 2"), *[("", "")] * 3]
    assert unexplained(rows) == [ROWS[2], ROWS[3]]


def test_the_summary_names_whatever_differs_and_counts(tmp_path: Path) -> None:
    rows = attributed(ROWS, KNOWN)
    lines = summary(rows)
    assert "peer test_b[1]: theirs: they count from 2" in lines
    assert "other test_b[1]: UNEXPLAINED: 4 != 1" in lines
    assert lines[-1] == "ran: 1 passed, 1 attributed, 2 unexplained, 1 not run; 1 of them are peers' own tests"
    write(rows, tmp_path)
    assert "peer\ttest_b[1]\tdiffers\ttheirs\tthey count from 2" in (tmp_path / "table.tsv").read_text().splitlines()
    assert len(json.loads((tmp_path / "table.json").read_text())) == len(rows)


@pytest.mark.parametrize("entry", ['fault = "nobody"\nwhy = "x"', 'fault = "ours"\nwhy = ""'])
def test_an_explanation_has_to_explain(entry: str, tmp_path: Path) -> None:
    path = tmp_path / "deviations.toml"
    path.write_text(f'[[deviation]]\npeer = "peer"\ntests = ["*"]\n{entry}\n')
    with pytest.raises(ValueError, match="fault has to be one of"):
        deviations(path)


def test_no_known_deviation_is_our_fault() -> None:
    assert {known.fault for known in deviations()} == {"theirs", "neither"}


def test_sources_are_of_the_versions_that_we_install() -> None:
    lock = (ROOT / "requirements.lock").read_text()
    assert len(pinned()) == 3
    assert [name for name, (version, _) in pinned().items() if f"\n{name}=={version} " not in lock] == []
