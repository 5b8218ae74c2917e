"""The safety case: each requirement has a test, each fault serves one, and its tables leave out nothing there is."""

import re
from pathlib import Path

from docs.safety_case_page import (
    PAGE,
    held_by_tests,
    requirements,
    safety_case_page,
    served_by_faults,
)
from drivers.families.stage.stage_fd import DBC
from drivers.protocols.answer_fields import Field
from drivers.protocols.dbc_codec import load_dbc
from hil.cycle.fault_table import ROWS
from hil.live.runtime_paths import RuntimePaths
from tests.support.paths import ROOT

TEXT = PAGE.read_text(encoding="utf-8")
DEMANDED = requirements(TEXT)


def section(title: str) -> list[list[str]]:
    """The cells of the table below that heading, its head left out."""
    lines = TEXT.partition(f"\n## {title}\n")[2].partition("\n## ")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")][1:]


def test_every_requirement_has_a_test_and_every_mark_a_requirement() -> None:
    carried = held_by_tests()
    assert sorted(set(DEMANDED) - set(carried)) == [], "requirements without a test"
    assert sorted(set(carried) - set(DEMANDED)) == [], "marks that name no requirement of docs/safety-case.md"


def test_every_fault_serves_a_requirement() -> None:
    carried = served_by_faults()
    assert carried.get("", []) == [], "faults whose row names no requirement"
    assert sorted(set(carried) - set(DEMANDED)) == [], "rows that name no requirement of docs/safety-case.md"


def test_a_requirement_is_found_in_the_page_and_a_test_by_its_mark(tmp_path: Path) -> None:
    page = "| SR-1.1 | One. | every frame |\n| H-1 | A hazard. | harm |\n| SR-12.10 | Two. | start |\n"
    assert requirements(page) == {"SR-1.1": "One.", "SR-12.10": "Two."}
    (tmp_path / "tests").mkdir()
    marks = '@pytest.mark.requirement(id="SR-1.1")\n@pytest.mark.requirement(id="SR-1.2")\ndef test_it() -> None: ...\n'
    (tmp_path / "tests" / "test_it.py").write_text(f'{marks}# @pytest.mark.requirement(id="SR-9.9")\n')
    assert list(held_by_tests(tmp_path / "tests")) == ["SR-1.1", "SR-1.2"]


def test_the_page_is_up_to_date() -> None:
    assert safety_case_page() == TEXT, "make docs"


def test_every_name_in_its_tables_is_one() -> None:
    named = set(re.findall(r"\bSR-\d+\.\d+\b", TEXT))
    assert named <= set(DEMANDED)
    for prefix in ("A", "H", "R", "SF"):
        stated = set(re.findall(rf"^\| ({prefix}-\d+) \|", TEXT, re.MULTILINE))
        assert set(re.findall(rf"(?<![\w-]){prefix}-\d+\b", TEXT)) == stated


def test_every_hazard_and_requirement_has_its_safety_function() -> None:
    functions = {row[0] for row in section("Safety functions")}
    assert {name.strip() for row in section("Hazards") for name in row[3].split(",")} == functions
    assert {f"SF-{name.removeprefix('SR-').partition('.')[0]}" for name in DEMANDED} == functions


def test_every_field_of_an_answer_has_its_failure_with_every_fault_that_guards_it() -> None:
    found = [(row[0], row[4]) for row in section("How each field can fail") if row[1] == "answer"]
    assert {name for name, _ in found} == {field.value for field in Field}
    for row in ROWS.values():
        for field in row.guards:
            assert any(name == field.value and f"`{row.name.lower()}`" in by for name, by in found), (row.name, field)


def test_every_field_of_a_command_has_its_failure() -> None:
    signals = {signal.name.rstrip("_0123") for signal in load_dbc(DBC).get_message_by_name("Command").signals}
    assert {row[0] for row in section("How each field can fail") if row[1] == "command"} == signals


def test_every_runtime_file_and_process_has_its_failure() -> None:
    files = " ".join(row[0] for row in section("How each file can fail"))
    missing = {name for name in RuntimePaths._fields if f"`{name}`" not in files} - {"directory"}
    assert missing == set()
    processes = {row[0] for row in section("How each process can fail")}
    tour = (ROOT / "docs" / "architecture.md").read_text().partition("## Processes")[2].partition("\n## ")[0]
    named = {cell.partition(", a child")[0] for cell in re.findall(r"^\| (`[^|]+) \|", tour, re.MULTILINE)}
    assert named == processes
