"""What a law may declare of its gains: everything `hil tune` will read is checked where a rig takes the law."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.control.gain import LARGEST, SCALES, Gain, Knob, declared
from hil.control.law_registry import law_class
from hil.rig.law_names import LAWS
from hil.rig.schema import LawConfig

IMPOSSIBLE = {
    "scale": (Gain(None, tune=Knob(0.01, 1.0, "m/T^2")), "Knob scale 'm/T^2': expected one of 1, 1/T, m,"),
    "plan's scale": (Gain(None, plan=Knob(0.01, 1.0, "kg")), "plan: Knob scale 'kg'"),
    "low of zero": (Gain(1.0, tune=Knob(0.0, 1.0)), "expected 0 < low <= high"),
    "turned range": (Gain(1.0, tune=Knob(2.0, 1.0)), "expected 0 < low <= high"),
    "words for a range": (Gain(1.0, tune=Knob("low", 1.0)), "expected 0 < low <= high"),  # type: ignore[arg-type]
    "endless range": (Gain(1.0, tune=Knob(1.0, float("inf"))), "expected 0 < low <= high"),
    "a tuple": (Gain(1.0, tune=(0.1, 1.0)), "expected a hil.Knob"),  # type: ignore[arg-type]
    "of itself": (Gain(1.0, tune=Knob(0.1, 1.0, of="gain")), "expected another gain of this law: other"),
    "of nothing": (Gain(1.0, tune=Knob(0.1, 1.0, of="mass")), "expected another gain of this law: other"),
    "default below least": (Gain(-1.0), "default = -1.0: expected None, or a finite number >= 0"),
    "default above most": (Gain(3.0, most=2.0), "expected None, or a number from 0 to 2"),
    "a truth": (Gain(True), "default = True"),  # type: ignore[arg-type]
    "a word that is none": (Gain("fast", words=("slow",)), "expected one of words, 'slow'"),
    "limits turned": (Gain(None, least=2.0, most=1.0), "expected two numbers, the first not above the second"),
    "no number for a limit": (Gain(None, least=float("nan")), "expected two numbers"),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_an_impossible_declaration_is_refused_with_the_gain_and_what_is_allowed(name: str) -> None:
    gain, text = IMPOSSIBLE[name]
    with pytest.raises(ValueError, match=r"GAINS\['gain'\]: ") as caught:
        declared({"gain": gain, "other": 1.0})
    assert text in str(caught.value)


@pytest.mark.long
@given(
    st.floats(allow_nan=True) | st.integers(), st.floats() | st.text(max_size=3), st.sampled_from([*SCALES, "N", ""])
)
def test_a_declaration_is_taken_or_refused_in_one_line(low: float, high: float, scale: str) -> None:
    gains = {"gain": Gain(None, tune=Knob(low, high, scale))}  # type: ignore[arg-type]
    if scale in SCALES and isinstance(high, int | float) and 0.0 < low <= high <= LARGEST:
        assert declared(gains) == gains
    else:
        with pytest.raises(ValueError, match=r"^GAINS\['gain'\]: tune: [^\n]+$"):
            declared(gains)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_of_ours_may_be_declared_as_it_is(name: str) -> None:
    assert declared(law_class(LawConfig(name=name)).GAINS)
