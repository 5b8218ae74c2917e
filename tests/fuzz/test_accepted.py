"""What `hil check` accepts, every command accepts: drawn laws, drawn rigs."""

from pathlib import Path

import pytest

from tests.fuzz import accepted
from tests.fuzz.accepted import KINDS, BrokenError, Counter, try_all

FEW = 8  # a second or two each; a thousand of each kind: python -m tests.fuzz.accepted laws


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_few_drawn_ones(kind: str, tmp_path: Path) -> None:
    kept = tmp_path / "kept.jsonl"
    assert try_all(kind, FEW, seed=2, kept=kept) == 0
    assert '"check: 0"' in kept.read_text(), "one at least was accepted, and went through the other commands"


def test_a_run_goes_on_where_it_ended_and_draws_again_what_broke(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn, kept = [], tmp_path / "kept.jsonl"

    def tried(kind: str, number: int, seed: int) -> Counter[str]:
        drawn.append(number)
        if number == 1 and len(drawn) == 2:
            raise BrokenError("draw 1")
        return Counter({"check: 0": 1})

    monkeypatch.setattr(accepted, "tried", tried)
    assert try_all("laws", 3, 1, kept) == 1
    assert "BROKEN: draw 1" in capsys.readouterr().out
    assert try_all("laws", 4, 1, kept) == 0
    assert drawn == [0, 1, 2, 1, 3]
    assert capsys.readouterr().out == "laws, seed 1: 0 broken in 4: check: 0 4\n"
    assert try_all("laws", 1, 2, kept) == 0
    assert drawn[5:] == [0], "another seed is another draw"
