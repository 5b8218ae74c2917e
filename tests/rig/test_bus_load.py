"""Whether traffic fits, and what a layout costs, in the numbers and words that people are given."""

import pytest

from hil.rig.bus_load import emulation_notes, feedback_notes, highest_rate, problems, rig_layout
from hil.rig.file import load_rig
from tests.support.judged import analysed
from tests.support.paths import RIGS

PAPER, ODRIVE = RIGS / "paper.toml", RIGS / "odrive.toml"


@pytest.mark.parametrize(
    ("overrides", "age", "counts", "rest"),
    [
        ([], "0.2 to 2.2 ms old", "counts 2 ms", "0.2 ms, costs 0.06 degrees"),  # 0.175 ms behind the tick's start
        (["bus.dbc.feedback_period_s=0"], "0.2 to 2.2 ms old", "counts 2 ms", "0.2 ms, costs 0.06 degrees"),
        (["bus.dbc.feedback_period_s=0.0005"], "0.2 to 0.7 ms old", "counts 2 ms", "0.0 ms, costs 0.00 degrees"),
        (["rate_hz=250"], "0.2 to 2.2 ms old", "counts 4 ms", "0.0 ms, costs 0.00 degrees"),
    ],
)
def test_a_rig_is_told_what_feedback_in_the_drives_own_time_costs(
    overrides: list[str], age: str, counts: str, rest: str
) -> None:
    rig = load_rig(ODRIVE, ["rate_hz=500", *overrides])
    (note,) = feedback_notes(rig, rig_layout(rig, RIGS))
    assert [part for part in (age, counts, rest) if part not in note] == []


def test_drives_that_are_triggered_cost_nothing_of_that() -> None:
    rig = load_rig(PAPER)
    assert feedback_notes(rig, rig_layout(rig, RIGS)) == []


def test_a_users_layout_is_told_that_its_drives_are_emulated_by_itself_unless_they_are_not() -> None:
    rig, odrive = load_rig(PAPER), load_rig(ODRIVE)
    assert emulation_notes(rig) == []
    named = rig.bus.model_copy(update={"protocol": "./maker.py:Maker"})
    (note,) = emulation_notes(rig.model_copy(update={"bus": named}))
    assert note.startswith("emulated drives: the drives' side of ./maker.py:Maker itself.")
    assert emulation_notes(odrive.model_copy(update={"bus": named})) == []


@pytest.mark.parametrize("rate", [4259, 8000, 8000.5])
def test_a_rate_that_does_not_fit_is_told_the_highest_that_does(rate: float) -> None:
    rig = load_rig(PAPER, [f"rate_hz={rate}"])
    analysis = analysed(rig)
    bus, frame = problems(rig, RIGS, analysis)
    assert bus.startswith(f"bus.protocol = 'stage_fd' at 1000000 bit/s does not fit rate_hz = {rate:g} with 2 axes: ")
    assert "past its deadline of" in frame
    assert frame.endswith("; rate_hz = 4258 or less, a higher bit rate or a leaner layout would do")
    fits = load_rig(PAPER, ["rate_hz=4258"])
    assert problems(fits, RIGS, analysed(fits)) == []


def test_the_numbers_of_a_refusal_are_those_of_the_analysis() -> None:
    """234.8 us of frames, the last of which but one ends 37.2 us late."""
    rig = load_rig(PAPER, ["rate_hz=8000"])
    assert problems(rig, RIGS, analysed(rig)) == [
        "bus.protocol = 'stage_fd' at 1000000 bit/s does not fit rate_hz = 8000 with 2 axes: worst-case load 187.8%, "
        "cyclic part 234.8 us of 125.0 us per tick",
        "frame 'feedback 0' ends up to 162.2 us after the tick's start, 37.2 us past its deadline of 125.0 us; "
        "rate_hz = 4258 or less, a higher bit rate or a leaner layout would do",
    ]


@pytest.mark.parametrize(("bitrate", "highest"), [(12_000, None), (12_500, 10), (14_000, 11)])
def test_where_the_lowest_rate_does_not_fit_none_is_named(bitrate: int, highest: int | None) -> None:
    rig = load_rig(RIGS / "microscope-ideal.toml", [f"bus.bitrate={bitrate}", f"bus.data_bitrate={bitrate}"])
    assert highest_rate(rig, RIGS) == highest
    assert (f"rate_hz = {highest} or less, " in problems(rig, RIGS, analysed(rig))[1]) == (highest is not None)
