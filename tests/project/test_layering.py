"""The house has floors: imports run downwards, between the rooms and inside them, and there is no circle.

`ROOMS` lists the rooms of hil from the top down, `FILES` the files of the rooms that run at the rig. A module may
import from what stands further down, never from what stands further up. drivers and sim_plant know nothing of hil. The
second half loads modules in a fresh interpreter and looks at what came with them.
"""

import ast
import graphlib
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.support.paths import ROOT

ROOMS = (
    "__main__",
    "adapters",
    "connection",
    "studies",
    "identify",
    "page",
    "camera",
    "operate",
    "runs",
    "virtual",
    "telemetry",
    "live",
    "events",
    "cycle",
    "analysis",
    "control",
    "cli",
    "rig",
)
PACKAGES = ("hil", "sim_plant", "drivers")  # likewise from the top down
FILES = {
    "live": (
        "teller run loop journal task_loading kept_learnt stop_line timing_record realtime task_file watched_file "
        "systemd miss_ledger pacing goal_link ring mailbox goal_page mapped_file runtime_paths stop_page file_lock"
    ),
    "events": (
        "sources marks notes stream refusals accuracy baseline forces windows followed causes motion_causes ringing "
        "axis_model storm event table"
    ),
    "cycle": (
        "step supervisor guards withdrawal homing press_watch axis_homing goal_desk decided_motion commissioning axes "
        "record_builder limits damped_stop "
        "sampling drive_clock reading_faults fault_monitor rest_watch travel oscillation fault_evidence fault_table "
        "inbox readings record gate output_gate command_desk state_machine tick goal"
    ),
}
# A law that looks at all axes at once is one on arrays, in the compiled build too: there, hil/floats has every other
# module a second time, and this one import leads out of it (deploy/compiled/build.py, SEAM).
SEAM = ("hil.control.laws.coupled", "hil.control.laws")


@cache
def modules() -> dict[str, Path]:
    """Every module of the product, by name."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            found[".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")] = path
    return found


def imported(tree: ast.Module, known: dict[str, Path]) -> set[str]:
    """Names of ours that a source imports anywhere: at its top, in a function, or for its types alone."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in known else node.module for name in whole}
    return found & known.keys()


@cache
def graph() -> dict[str, set[str]]:
    """Which module imports which; the seam is left out."""
    known = modules()
    edges = {name: imported(ast.parse(path.read_text()), known) - {name} for name, path in known.items()}
    edges[SEAM[0]].discard(SEAM[1])
    return edges


def arrows() -> list[tuple[str, str]]:
    return [(name, target) for name, targets in graph().items() for target in sorted(targets)]


def room(name: str) -> str | None:
    """Of a module of hil; None: the package itself, which is everybody's, or another package."""
    parts = name.split(".")
    return parts[1] if parts[0] == "hil" and len(parts) > 1 else None


def test_an_import_is_found_wherever_it_stands() -> None:
    known = dict.fromkeys(("hil.a", "hil.a.b", "hil.c", "hil.d"), Path())
    source = "import hil.d\ndef f():\n    from hil.a import b, g\nif TYPE_CHECKING:\n    from hil.c import X\nimport os"
    assert imported(ast.parse(source), known) == {"hil.a", "hil.a.b", "hil.c", "hil.d"}


def test_the_tables_name_what_is_there() -> None:
    assert {room(name) for name in modules()} - {None} == set(ROOMS)
    for name, files in FILES.items():
        there = {path.stem for path in (ROOT / "hil" / name).glob("*.py")} - {"__init__"}
        assert there == set(files.split()), name


def test_drivers_and_the_plant_know_nothing_of_what_stands_on_them() -> None:
    floors = {name: PACKAGES.index(name.split(".")[0]) for name in modules()}
    assert [(a, b) for a, b in arrows() if floors[b] < floors[a]] == []


def test_between_rooms_imports_run_downwards() -> None:
    places = [(a, b, room(a), room(b)) for a, b in arrows()]
    upward = [(a, b) for a, b, here, there in places if here and there and ROOMS.index(there) < ROOMS.index(here)]
    assert upward == []


@pytest.mark.parametrize("name", FILES)
def test_inside_a_room_imports_run_downwards(name: str) -> None:
    order = [f"hil.{name}.{file}" for file in FILES[name].split()]
    inside = [(a, b) for a, b in arrows() if a in order and b in order]
    assert len(inside) > 5
    assert [(a, b) for a, b in inside if order.index(b) < order.index(a)] == []


def test_there_is_no_circle() -> None:
    list(graphlib.TopologicalSorter(graph()).static_order())  # CycleError names one


# what comes with an import --------------------------------------------------------------------------------------------

LUGGAGE = ("typer", "click", "rich", "cantools", "can", "canopen", "zenoh", "matplotlib", "scipy", "filterpy", "google")
NOT_THEIRS = ("hil.telemetry", "hil.operate", "hil.studies", "hil.virtual", "hil.cli.app", "hil.cli.output")


def loaded(statement: str) -> list[str]:
    """Modules that a fresh interpreter loads for a statement, as -X importtime lists them."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", statement], cwd=ROOT, capture_output=True, text=True, check=True
    )
    lines = [line.split("|")[-1].strip() for line in done.stderr.splitlines() if line.startswith("import time:")]
    return lines[1:]


def loaded_again(statement: str) -> list[str]:
    """As it is once the filter's gains are in their cache: where they are designed, filterpy and scipy are loaded."""
    loaded(statement)
    return loaded(statement)


def unwanted(names: list[str], forbidden: tuple[str, ...]) -> list[str]:
    return [name for name in names if any(name == bad or name.startswith(bad + ".") for bad in forbidden)]


def test_the_gate_comes_with_next_to_nothing() -> None:
    names = loaded("import hil.cycle.gate")
    assert unwanted(names, (*LUGGAGE, *NOT_THEIRS, "pydantic", "numpy", "hil.rig", "hil.control")) == []
    assert len(names) < 190  # it was 380 once, for an exception class in the file of the DBC parser


def test_a_tick_loads_every_file_of_the_cycle() -> None:
    files = {name for name in modules() if name.startswith("hil.cycle")}
    assert len(files) > 25
    assert files <= set(loaded("import hil.cycle.step"))


def test_the_cycle_comes_without_command_line_telemetry_and_can_libraries() -> None:
    assert unwanted(loaded("import hil.cycle.step"), (*LUGGAGE, *NOT_THEIRS, "hil.live", "argparse")) == []


def test_a_key_is_explained_without_the_schema_and_without_a_command_line_library() -> None:
    names = loaded("import sys; sys.argv[1:] = ['explain', 'law.name']; from hil.__main__ import main; main()")
    assert "hil.rig.key_text" in names
    assert unwanted(names, ("typer", "rich", "pydantic", "numpy", "hil.rig.schema", "sim_plant")) == []
    assert len(names) < 130


def test_the_version_of_a_package_is_looked_up_by_who_asks_for_it() -> None:
    assert (
        unwanted(loaded("import hil.cli.app"), ("importlib.metadata", "email", "rich.markup", "hil.rig.schema")) == []
    )


RUN_SHORTLY = """
import sys
sys.argv[1:] = ["run", "deploy/rigs/paper.toml", "--ticks", "20", "--set", "timing.realtime=false",
    "--set", "timing.lock_memory=false", "--set", "timing.dma_latency=false", "--set", "bus.interface=local",
    "--set", "timing.allow_degraded=true"]
from hil.__main__ import main
try:
    main()
except SystemExit as end:
    assert end.code == 0, end.code
"""


@pytest.mark.long
def test_the_control_process_comes_without_them_too_from_its_start_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    names = loaded_again(RUN_SHORTLY)
    assert "hil.live.loop" in names
    assert unwanted(names, (*LUGGAGE, *NOT_THEIRS)) == []
    # It was 641 once, 543 before homing and kept learning. numpy, and pydantic, which reads the rig file, are 307 of
    # them, with what they import (importlib.metadata, email, inspect); our own are 207, argparse, json and subprocess
    # most of the others.
    assert len(names) < 553


@pytest.mark.long
def test_a_resonance_that_the_rig_states_adds_no_library_to_the_control_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    names = loaded_again(RUN_SHORTLY.replace("paper.toml", "microscope.toml"))
    assert "hil.analysis.flexible_plant" in names
    assert unwanted(names, (*LUGGAGE, *NOT_THEIRS)) == []


@pytest.mark.long
def test_a_check_of_a_rig_loads_no_library_that_it_does_not_use() -> None:
    names = loaded_again("import sys; sys.argv[1:] = ['check', 'microscope']; from hil.__main__ import main; main()")
    assert unwanted(names, ("scipy", "matplotlib", "zenoh", "can")) == []
