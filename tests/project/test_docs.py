"""The pages made from tables in code say what the code says."""

import re

from docs.answers_page import answers_page
from docs.make_fault_numbers import FILE as FAULT_NUMBERS
from docs.make_fault_numbers import numbers
from docs.make_pages import (
    FOLDER,
    SCHEMA,
    faults_page,
    gains_table,
    laws_page,
    rig_file_page,
    rig_schema,
    states_page,
)
from hil.control.law_registry import law_class
from hil.cycle.fault_table import ROWS, Fault
from hil.rig.law_names import LAWS
from hil.rig.reference import WRITTEN, as_json, in_schema
from hil.rig.schema import LawConfig
from tests.support.paths import ROOT

RENEW = "make docs"


def test_the_pages_are_up_to_date() -> None:
    assert FAULT_NUMBERS.read_text() == numbers(), RENEW
    assert (FOLDER / "states.md").read_text() == states_page(), RENEW
    assert (FOLDER / "faults.md").read_text() == faults_page(), RENEW
    assert (FOLDER / "answers.md").read_text() == answers_page(), RENEW
    assert (FOLDER / "rig-file.md").read_text() == rig_file_page(), RENEW
    assert SCHEMA.read_text() == rig_schema(), RENEW
    assert WRITTEN.read_text(encoding="utf-8") == as_json(in_schema()), RENEW
    assert (FOLDER / "laws.md").read_text() == laws_page(), RENEW


def test_every_gain_of_every_law_is_in_the_table() -> None:
    table = gains_table()
    assert "| pid | `ki` | from the rig | N/(m s) |" in table
    assert table.count("\n") - 2 == sum(len(law_class(LawConfig(name=name)).GAINS) for name in LAWS) + 5


def test_every_fault_has_a_rule_and_every_rule_a_detector() -> None:
    assert set(ROWS) == set(Fault) - {Fault.NONE}
    files = ("fault_monitor", "reading_faults", "step", "supervisor", "sampling")
    code = "".join((ROOT / "hil" / "cycle" / f"{name}.py").read_text() for name in files)
    body = code[code.index("class FaultMonitor") :]
    unseen = [f.name for f, rule in ROWS.items() if not rule.status and not re.search(rf"Fault\.{f.name}\b", body)]
    assert unseen == []
