"""docs/inputs.md states the limits that the code has."""

from pathlib import Path

import pytest

from drivers.base.toml_file import DEEPEST, LARGEST, MOST_PROBLEMS
from drivers.eds import reader as eds
from drivers.protocols import dbc_codec
from hil.analysis import frequency_response
from hil.rig import brought, npz_file, task_file
from hil.runs import files as run_files
from hil.runs import trace_file
from hil.telemetry import codec, command_wire, mcap_items, session
from tests.support.paths import ROOT

PAGE = (Path(ROOT) / "docs" / "inputs.md").read_text()
STATED = {
    "rig file, scenario": (LARGEST, DEEPEST, MOST_PROBLEMS),
    "DBC file": (dbc_codec.LARGEST,),
    "EDS or DCF file": (eds._LARGEST,),
    "Python file of a law": (brought.LARGEST_PLUGIN,),
    "task file": (task_file.LARGEST, task_file.MOST_COLUMNS, task_file.MOST_ROWS, npz_file.UNFOLDING),
    "measured response": (frequency_response.LARGEST_FILE, frequency_response.MOST_LINES),
    "recording": (mcap_items.LARGEST_FILE, mcap_items.LARGEST_RECORD, mcap_items.UNFOLDING, codec.LONGEST_BATCH),
    "exported run": (run_files._LARGEST, npz_file.MOST_ARRAYS, npz_file.UNFOLDING),
    "trace of a bus": (trace_file.LARGEST, trace_file.LONGEST_LINE, trace_file.LARGEST_BLOCK),
    "Zenoh message": (session.LARGEST_MESSAGE,),
    "command, or a task": (command_wire.LIMIT,),
}


@pytest.mark.parametrize("what", STATED)
def test_the_page_states_the_limits_of_the_code(what: str) -> None:
    [row] = [line for line in PAGE.splitlines() if line.startswith(f"| {what}")]
    assert [number for number in STATED[what] if f" {number} " not in f"{row} "] == []
