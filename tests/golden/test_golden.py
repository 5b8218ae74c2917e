"""The goldens themselves: every story has one, none is left over, an addition moves no other, acceptance is by room."""

import sys
from pathlib import Path

import pytest

from sim_plant.scenario import injector
from sim_plant.scenario.language import KINDS, Kind
from tests.golden import __main__ as command
from tests.golden import golden
from tests.golden.stories import tell as stories
from tests.golden.wires import tell as wires


@pytest.mark.parametrize("room", golden.rooms())
def test_every_story_has_a_golden_of_its_own_and_there_is_no_other(room: str) -> None:
    names = list(golden.teller(room).stories())
    paths = [golden.path_of(room, name) for name in names]
    assert len(set(paths)) == len(names) > 0
    texts = [path.read_text(encoding="utf-8") for path in paths]
    assert [text.splitlines()[0] for text in texts] == [f"# {name}" for name in names]
    assert len({text.partition("\n")[2] for text in texts}) > 0.9 * len(texts), "they do differ"
    assert golden.stray(room) == []
    assert (golden.HERE / room / golden.REASONS).exists()


@pytest.mark.long
def test_a_new_kind_of_fault_moves_no_story(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its name sorts into the middle: whoever drew from a list of all kinds would draw others now."""
    monkeypatch.setitem(KINDS, "limit_probe", Kind("the drive says that its encoder cannot be trusted"))
    monkeypatch.setitem(injector._BEGIN, "limit_probe", injector._BEGIN["encoder_fault"])
    for story in stories.stories()[::7]:
        golden.hold("stories", story)
    for story in wires.stories()[::7]:
        golden.hold("wires", story)


class Rooms:
    """Two made-up rooms, `one` and `two`, with two stories each; told is what they tell."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.told = {"calm": ["nothing, 0 N"], "a storm": ["a wave, 3 m"]}
        for room in ("one", "two"):
            (folder / room).mkdir()
            (folder / room / "tell.py").touch()

    def stories(self) -> list[str]:
        return list(self.told)

    def tell(self, story: str) -> list[str]:
        return self.told[story]

    def texts(self, room: str) -> dict[str, str]:
        return {path.name: path.read_text() for path in sorted((self.folder / room).iterdir()) if path.suffix != ".py"}


@pytest.fixture
def made_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rooms:
    found = Rooms(tmp_path)
    monkeypatch.setattr(golden, "HERE", tmp_path)
    monkeypatch.setattr(command, "HERE", tmp_path)
    for module in (golden, command):
        monkeypatch.setattr(module, "teller", lambda room: found)
    return found


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["golden", *arguments])
    try:
        command.main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def test_one_room_is_taken_with_its_reason_beside_it_and_the_other_is_as_it_was(
    made_up: Rooms, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--accept", "one", "--reason", "these are the first ones") == 0
    assert set(made_up.texts("one")) == {"calm.txt", "a-storm.txt", "REASONS"}
    assert made_up.texts("one")["a-storm.txt"] == "# a storm\na wave, 3 m\n"
    assert "these are the first ones" in made_up.texts("one")["REASONS"]
    assert made_up.texts("two") == {}
    assert run(monkeypatch, "one") == 0, "nothing differs any more"
    before = made_up.texts("one")
    assert run(monkeypatch, "--accept", "one", "--reason", "there is no change now") == 0
    assert made_up.texts("one") == before, "a reason without a change is not kept"


def test_what_differs_is_shown_line_by_line_and_fails(
    made_up: Rooms, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    golden.accept("one", "these are the first ones", "2026-01-01")
    made_up.told = {"a storm": ["a wave, 4 m"], "snow": ["a flake, 1 mg"]}
    capsys.readouterr()
    assert run(monkeypatch, "one") == 1
    shown = capsys.readouterr().out
    for line in ("    -a wave, 3 m", "    +a wave, 4 m", "new: one/snow.txt", "gone: one/calm.txt", "3 goldens differ"):
        assert line in shown
    with pytest.raises(AssertionError, match="make review one"):
        golden.hold("one", "a storm")
    assert set(made_up.texts("one")) == {"calm.txt", "a-storm.txt", "REASONS"}, "to look changes nothing"
    assert len(golden.accept("one", "the sea got rougher", "2026-01-02")) == 3
    assert set(made_up.texts("one")) == {"snow.txt", "a-storm.txt", "REASONS"}


@pytest.mark.parametrize(
    "arguments",
    [
        ("--accept", "one"),
        ("--accept", "one", "--reason", ""),
        ("--accept", "one", "--reason", "because"),
        ("--reason", "for no room at all"),
        ("two", "--accept", "one", "--reason", "two rooms at once"),
        ("--accept", "one", "two", "--reason", "two rooms at once"),
        ("--accept", "all", "--reason", "all rooms at once"),
    ],
)
def test_nothing_is_taken_without_a_reason_and_never_two_rooms(
    made_up: Rooms, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]
) -> None:
    assert run(monkeypatch, *arguments) == 2
    assert made_up.texts("one") == made_up.texts("two") == {}


def test_tables_become_lines_with_paths() -> None:
    found = golden.outline({"a": {"b": 1.5, "c": "x"}, "d": [{"e": [1, 2]}], "f": "two\nlines"})
    assert list(found) == ["a: b 1.5, c x", "d[0].e: [1, 2]", "f:", "    two", "    lines"]
