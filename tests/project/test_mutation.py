"""The mutation lane itself: its mutants are what they say, its tables name what exists, its rule is fair."""

import ast
import math
import re
from pathlib import Path

import pytest

from tests.mutation import careless
from tests.mutation.explained import Explained
from tests.mutation.fork_server import COPIED
from tests.mutation.mutants import differs, mutants_of
from tests.mutation.rooms import ROOMS, files_to_run, python_files, sources_of
from tests.mutation.sample import DEMANDED, UNFAIR, Case, draw, most_survivors
from tests.support.paths import ROOT

SOURCE = b'''"""Text."""

LIMIT: int = 5


def clamp(value: float, most: float = 2.0) -> float:
    """Text."""
    if value > most and not value < 0:
        value = min(most, value)
    return value
'''


def test_every_small_change_is_made_once_and_nothing_else() -> None:
    found = [(mutant.kind, *mutant.lines(SOURCE)) for mutant in mutants_of("a.py", SOURCE)]
    condition, clamp = "if value > most and not value < 0:", "value = min(most, value)"
    signature = "def clamp(value: float, most: float = 2.0) -> float:"
    assert sorted(found) == sorted(
        [
            ("constant", "LIMIT: int = 5", "LIMIT: int = 6"),
            ("constant", "LIMIT: int = 5", "LIMIT: int = 4"),
            ("constant", signature, signature.replace("2.0", "4.0")),
            ("comparison", condition, condition.replace(">", ">=")),
            ("comparison", condition, condition.replace(">", "<=")),
            ("comparison", condition, condition.replace("<", "<=")),
            ("comparison", condition, condition.replace("<", ">=")),
            ("constant", condition, condition.replace("0", "1")),
            ("constant", condition, condition.replace("0", "(-1)")),
            ("drop not", condition, condition.replace("not ", "")),
            ("logic", condition, condition.replace("and", "or")),
            ("negate condition", condition, "if (not (value > most and not value < 0)):"),
            ("delete statement", clamp, "pass"),
            ("other function", clamp, clamp.replace("min", "max")),
            ("return nothing", "return value", "return None"),
        ]
    )


def test_what_only_a_mistake_of_ours_could_tell_is_left_alone() -> None:
    source = b"""
def among(values: list[int], others: list[int]) -> bool:
    for value, other in zip(values, others, strict=True):
        if value == other:
            return True
    return False
"""
    found = [mutant.lines(source) for mutant in mutants_of("a.py", source)]
    assert not any("strict=False" in after for _, after in found)
    assert [after for before, after in found if before == "return False"] == ["return True"]
    assert sorted(after for before, after in found if before == "return True") == ["return False", "return None"]


def test_a_mutant_differs_in_one_place_and_parses() -> None:
    path = "hil/cycle/inbox.py"
    source = (ROOT / path).read_bytes()
    mutants = mutants_of(path, source)
    assert len(set(mutants)) == len(mutants) > 100
    for mutant in mutants[::10]:
        assert differs(mutant, source)
        assert mutant.apply(source).replace(mutant.text, b"", 1) != source


@pytest.mark.parametrize("name", ROOMS)
def test_every_room_has_sources_and_tests_of_its_own(name: str) -> None:
    sources = sources_of(ROOT, name)
    assert sources
    assert all((ROOT / path).exists() for path in (*ROOMS[name].sources, *ROOMS[name].tests))
    for source in sources:
        tests = files_to_run(ROOT, ROOMS[name], source)
        assert tests
        assert len(set(tests)) == len(tests)


def test_no_file_is_in_two_rooms_and_the_safety_core_is_in_one() -> None:
    files = [file for name in ROOMS for file in sources_of(ROOT, name)]
    assert len(set(files)) == len(files)
    core = (
        "hil/cycle",
        "hil/control/laws",
        "hil/control/trajectories",
        "drivers/protocols",
        "drivers/wire",
        "drivers/bus",
        "sim_plant/physics",
    )
    assert {file for path in core for file in python_files(ROOT, path)} <= set(files)


def test_every_test_of_the_mutated_folders_is_in_a_room() -> None:
    """A file that is left out notices no mutant, and nobody would miss it."""
    taken = {test for room in ROOMS.values() for test in files_to_run(ROOT, room, room.sources[0])}
    for folder in ("cycle", "control", "drivers", "sim_plant", "live", "telemetry", "rig"):
        tests = {path for path in python_files(ROOT, f"tests/{folder}") if Path(path).name.startswith("test_")}
        assert tests <= taken


def test_whatever_a_rooms_tests_read_is_in_the_tree_that_they_run_in() -> None:
    """A test that misses a file there fails with every mutant, and seems to have noticed it."""
    files = {test for room in ROOMS.values() for test in files_to_run(ROOT, room, room.sources[0])}
    files |= set(python_files(ROOT, "tests/support"))
    read = {name for file in files for name in re.findall(r'ROOT / "(\w+)', (ROOT / file).read_text(encoding="utf-8"))}
    assert {"examples", "deploy"} <= read, "or it finds nothing"
    assert {name for name in read if (ROOT / name).is_dir()} <= set(COPIED)


def test_every_explanation_says_why() -> None:
    explained = Explained()
    for row in explained.rows:
        assert row["why"].split(":")[0] in ("equivalent", "harmless"), row
        assert len(row["why"]) > 20, row
    for test in explained.green:
        path, _, name = test.partition("::")
        assert f"def {name}(" in (ROOT / path).read_text(encoding="utf-8"), test


def test_the_rule_hardly_ever_fails_a_tree_that_keeps_its_promise_and_mostly_one_that_does_not() -> None:
    def more_than(allowed: int, tried: int, rate: float) -> float:
        at_most = range(allowed + 1)
        return 1 - math.fsum(math.comb(tried, k) * (1 - rate) ** k * rate ** (tried - k) for k in at_most)

    for tried in (20, 60, 100, 300):
        allowed = most_survivors(tried)
        assert more_than(allowed, tried, DEMANDED) <= UNFAIR < more_than(allowed - 1, tried, DEMANDED)
    assert more_than(most_survivors(100), 100, 0.8) > 0.9


def test_a_seed_chooses_the_same_mutants_again_and_another_seed_others() -> None:
    path = Path("hil/cycle/inbox.py")
    source = (ROOT / path).read_bytes()
    cases = [Case("cycle", mutant, *mutant.lines(source)) for mutant in mutants_of(str(path), source)]
    first, again, other = (draw(list(cases), seed, 20) for seed in ("a", "a", "b"))
    assert first == again != other


# mistakes written down by hand ----------------------------------------------------------------------------------------


def test_every_mistake_stands_once_in_its_file_changes_what_it_does_and_names_a_test_that_is_there() -> None:
    for mistake in careless.table():
        source = (ROOT / mistake.file).read_text()
        wrong = careless.mutated(mistake, source)
        assert ast.dump(ast.parse(wrong)) != ast.dump(ast.parse(source)), mistake.name
        assert mistake.kind in careless.KINDS, mistake.name
        assert bool(mistake.killer) != bool(mistake.why), f"{mistake.name}: a test, or why none needs to notice"
        if mistake.killer:
            path, _, name = mistake.killer.partition("::")
            assert f"def {name.partition('[')[0]}(" in (ROOT / path).read_text(), mistake.killer


def test_the_mistakes_are_of_every_kind_and_of_every_part_that_stands_before_the_drives() -> None:
    rows = careless.table()
    assert len(rows) >= 70
    assert len(set(rows)) == len(rows)
    assert {mistake.kind for mistake in rows} == set(careless.KINDS)
    files = {Path(mistake.file).stem for mistake in rows}
    assert files >= {"gate", "state_machine", "supervisor", "fault_monitor", "inbox", "sampling", "stage_fd"}


def test_a_mistake_whose_line_has_changed_is_told() -> None:
    mistake = careless.Mistake("stale", "hil/cycle/gate.py", "self.force = nothing", "pass", "x")
    with pytest.raises(ValueError, match=r"gate\.py: stale: self\.force = nothing: stands 0 times in the file"):
        careless.mutated(mistake, "self.force = force\n")
