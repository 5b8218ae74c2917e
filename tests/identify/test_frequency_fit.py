"""Mass, lag and mode from a multisine on two masses that this file integrates; poor data is refused."""

import numpy as np
import pytest

from hil.analysis.flexible_plant import AxisDynamics
from hil.identify.estimate import Estimate, Refused
from hil.identify.frequency_fit import Pass, Response, fit_axis, paired, response_of
from hil.identify.modes_told import Mode, modes_told

PERIOD, FINE, BASE = 1e-3, 40, 200
LINES = range(1, 80, 2)  # 5 to 395 Hz
MASS, LAG, MODE, DAMPING, LOAD, VISCOUS = 0.9, 3e-4, 120.0, 0.03, 0.3, 4.0


def passes(mode: bool, noise: float = 0.0, size: float = 0.03, delay: int = 0) -> list[Pass]:
    """Eight passes there and back at 20 mm/s, ++--, in one integration. delay: steps of PERIOD / FINE by which a force
    acts late, at most FINE.
    """
    random = np.random.default_rng(7)
    phases = random.uniform(0.0, 6.28, len(LINES))
    k = np.arange(BASE)[:, None]
    wave = size * np.cos(2.0 * np.pi * np.array(LINES) * k / BASE + phases).sum(axis=1)
    load = LOAD * MASS if mode else 1e-9
    motor, spring = MASS - load, load * (2.0 * np.pi * MODE) ** 2
    damper = 2.0 * DAMPING * load * 2.0 * np.pi * MODE
    out = []
    for number in range(8):
        direction, sign = (1, -1)[number % 2], (1, 1, -1, -1)[number % 4]
        x = tool = driven = before = 0.0
        v = w = direction * 0.02
        forces, positions = [], []
        step = PERIOD / FINE
        for i in range(4 * BASE):
            u = sign * wave[i % BASE] - 200.0 * (x - direction * 0.02 * i * PERIOD) - 20.0 * (v - direction * 0.02)
            u += VISCOUS * direction * 0.02
            forces.append(u)
            positions.append(x)
            for fine in range(FINE):
                driven += ((u if fine >= delay else before) - driven) * step / LAG
                pull = spring * (tool - x) + damper * (w - v) if mode else 0.0
                v += (driven - VISCOUS * v + pull) / motor * step
                x += v * step
                if mode:
                    w -= pull / load * step
                    tool += w * step
            before = u
        measured = np.array(positions[2 * BASE :]) + random.normal(0.0, noise + 1e-12, 2 * BASE)
        out.append(Pass(np.array(forces[2 * BASE :]), np.zeros(2 * BASE), measured, direction, sign, 0))
    return out


def test_a_mode_is_found() -> None:
    measured = response_of(passes(True, 2e-9), PERIOD, LINES, BASE)
    assert measured.coherence.min() > 0.9
    axis = fit_axis(measured, PERIOD, 0.5)
    found = axis.found
    assert found["mass"].value == pytest.approx(MASS, rel=0.01)
    assert found["mode_frequency_hz"].value == pytest.approx(MODE, rel=0.01)
    assert found["mode_damping"].value == pytest.approx(DAMPING, rel=0.15)
    assert found["mode_load"].value == pytest.approx(LOAD, abs=0.02)
    assert found["torque_lag"].value == pytest.approx(LAG, abs=60e-6)


def test_passes_are_paired_by_their_way_first_where_stalls_left_some_out() -> None:
    def one(sign: int, way: int) -> Pass:
        return Pass(np.zeros(4), np.zeros(4), np.zeros(4), 1, sign, 0, way)

    left = [one(1, 0), one(-1, 1), one(1, 1), one(-1, 2)]  # the others stalled
    assert [(a.way, b.way) for a, b in paired(left)] == [(1, 1), (0, 2)]
    assert all((a.sign, b.sign) == (1, -1) for a, b in paired(left))


@pytest.mark.parametrize("steps", [8, 20, FINE])
def test_a_delay_is_told_apart_from_the_lag(steps: int) -> None:
    """Of drives that act late, up to a whole period; against what steps of 25 us do to either."""
    late, prompt = (fit_axis(response_of(passes(True, 2e-9, delay=at), PERIOD, LINES, BASE), PERIOD, 0.5)
                    for at in (steps, 0))  # fmt: skip
    for quantity in ("delay", "torque_lag"):
        later = late.found[quantity].value - prompt.found[quantity].value
        assert later == pytest.approx(steps * PERIOD / FINE, abs=3e-6), quantity
    for quantity in ("mass", "mode_frequency_hz", "mode_load"):
        assert late.found[quantity].value == pytest.approx(prompt.found[quantity].value, rel=2e-3), quantity


def test_a_rigid_axis_has_no_mode() -> None:
    axis = fit_axis(response_of(passes(False, 2e-9), PERIOD, LINES, BASE), PERIOD, 1.5)
    assert axis.found["mass"].value == pytest.approx(MASS, rel=0.01)
    assert "no resonance" in axis.refused["mode"]


def test_noise_that_drowns_the_lines_is_refused() -> None:
    measured = response_of(passes(False, 1e-5), PERIOD, LINES, BASE)
    with pytest.raises(Refused, match=r"coherence above 0.9 in \d+ of 40 lines"):
        fit_axis(measured, PERIOD, 0.5)


def test_too_few_passes_are_refused() -> None:
    with pytest.raises(Refused, match="pairs of passes"):
        response_of(passes(False)[:4], PERIOD, LINES, BASE)


def answered(hertz: np.ndarray, response: np.ndarray) -> Response:
    """Six pairs of passes that differ by a thousandth."""
    random = np.random.default_rng(3)
    passes = response * (1.0 + 1e-3 * random.normal(size=(6, hertz.size)))
    deviation = 4e-4 * np.abs(response)
    return Response(hertz, response, deviation, np.ones(hertz.size), passes)


HERTZ = np.arange(6.0, 478.0, 4.0)
TOOL = (123.0, 0.02, 0.3)
OTHERS = [[(246.0, 0.012, 0.05)], [(246.0, 0.012, 0.05), (412.0, 0.008, 0.03)]]


def ringing(*modes: tuple[float, float, float]) -> Response:
    first, *others = modes
    axis = AxisDynamics(MASS, LAG, *first, VISCOUS)._replace(others=tuple(others))
    return answered(HERTZ, axis.response(2.0 * np.pi * HERTZ, PERIOD))


def told(found: dict[str, Estimate], name: str) -> tuple[float, ...]:
    return tuple(found[f"{name}_{key}"].value for key in ("frequency_hz", "damping", "load"))


@pytest.mark.parametrize("others", OTHERS)
def test_resonances_beside_the_tools_are_found(others: list[tuple[float, float, float]]) -> None:
    axis = fit_axis(ringing(TOOL, *others), PERIOD, 0.5)
    assert told(axis.found, "mode") == pytest.approx(TOOL, rel=0.01)
    for number, mode in enumerate(others, 1):
        assert told(axis.found, f"other_mode_{number}") == pytest.approx(mode, rel=0.02)
    assert f"other_mode_{len(others) + 1}_load" not in axis.found
    assert axis.found["mass"].value == pytest.approx(MASS, rel=0.002)
    assert not axis.refused


def test_light_resonances_are_not_taken_for_the_tool() -> None:
    axis = fit_axis(ringing(*OTHERS[1]), PERIOD, 1.5)
    assert "0.05 of the mass (a tool: at least 0.1)" in axis.refused["mode"]
    assert "mode_load" not in axis.found
    assert told(axis.found, "other_mode_1") == pytest.approx(OTHERS[1][0], rel=0.02)
    assert told(axis.found, "other_mode_2") == pytest.approx(OTHERS[1][1], rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
def test_drawn_resonances_are_found_within_their_intervals(seed: int) -> None:
    """At least 15 Hz apart; of all their quantities nine in ten, and no other."""
    random = np.random.default_rng(seed)
    hertz = np.sort(random.uniform(160.0, 440.0, 2))
    hertz[1] = max(hertz[1], hertz[0] + 15.0)
    others = [(float(each), random.uniform(0.005, 0.02), random.uniform(0.02, 0.08)) for each in hertz]
    tool = (random.uniform(60.0, 140.0), 0.02, random.uniform(0.15, 0.4))
    axis = fit_axis(ringing(tool, *others), PERIOD, 0.6)
    truth = zip(("mode", "other_mode_1", "other_mode_2"), (tool, *others), strict=True)
    held = [
        axis.found[f"{name}_{key}"].holds(value)
        for name, mode in truth
        for key, value in zip(("frequency_hz", "damping", "load"), mode, strict=True)
    ]
    assert sum(held) >= 8, (tool, others)
    assert not axis.refused


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_no_resonance_is_made_of_noise(seed: int) -> None:
    """Lines that are 0.5 % off, a tenth of which their passes show."""
    random = np.random.default_rng(seed)
    for modes, count in (([TOOL], 1), ([TOOL, *OTHERS[0]], 2)):
        clean = ringing(*modes)
        noise = 0.005 * (random.normal(size=HERTZ.size) + 1j * random.normal(size=HERTZ.size))
        axis = fit_axis(clean._replace(response=clean.response * (1.0 + noise)), PERIOD, 0.5)
        assert sum(name.endswith("_damping") for name in axis.found) == count


@pytest.mark.long
def test_an_axis_with_four_resonances_is_refused() -> None:
    four = ringing(TOOL, (200.0, 0.01, 0.05), (300.0, 0.01, 0.05), (400.0, 0.01, 0.05))
    with pytest.raises(Refused, match=r"chi\^2 \d+ per degree of freedom .at most \d+.: no axis of 3 modes or fewer"):
        fit_axis(four, PERIOD, 0.5)


@pytest.mark.long
def test_three_light_resonances_are_more_than_a_model_has_room_for() -> None:
    axis = fit_axis(ringing((200.0, 0.01, 0.05), (300.0, 0.01, 0.05), (400.0, 0.01, 0.05)), PERIOD, 0.5)
    assert axis.refused["other_modes"] == "3 resonances beside the tool's, at 200, 300, 400 Hz (at most 2)"
    assert not any(name.startswith("other_mode_") for name in axis.found)


def test_where_nothing_is_left_to_explain_no_resonance_is_sought() -> None:
    """Friction that varies as it passes left the lowest lines 1 % off; a mode of 5 Hz explained ten times as much."""
    hertz = np.arange(4.0, 478.0, 4.0)
    seems = AxisDynamics(1.0244 * MASS, LAG, 5.2, 0.023, 0.0235, VISCOUS).response(2.0 * np.pi * hertz, PERIOD)
    measured = answered(hertz, seems)
    measured.deviation[0] = 0.1 * abs(seems[0])
    axis = fit_axis(measured, PERIOD, 0.5)
    assert 0.05 < axis.chi2 < 1.0
    assert axis.refused == {"mode": "no resonance in 4 to 476 Hz"}
    assert axis.found["mass"].value == pytest.approx(MASS, rel=2e-3)


def test_a_resonance_whose_interval_has_none_is_not_told() -> None:
    """One of 5 Hz that stood for friction that varied as it passed: theta of a drawn microscope."""
    friction = Mode(Estimate(5.2, 1.8, "Hz"), Estimate(0.023, 0.06, "1"), Estimate(0.024, 0.028, "1"))
    tool = Mode(Estimate(120.0, 0.1, "Hz"), Estimate(0.02, 0.001, "1"), Estimate(0.3, 0.001, "1"))
    for modes in ([friction], [tool, friction]):
        found, refused = modes_told(modes, 4.0, 480.0)
        assert refused["mode_unsure"] == "5.2 Hz with 0.024 +- 0.028 of the mass (at most 50 %): it may be none"
        assert set(found) == {f"mode_{key}" for key in Mode._fields if tool in modes}
        assert ("mode" in refused) == (tool not in modes)


def test_a_resonance_beyond_the_lines_is_not_told() -> None:
    hertz = np.arange(6.0, 160.0, 2.0)
    axis = AxisDynamics(MASS, LAG, 180.0, 0.02, 0.3, VISCOUS).response(2.0 * np.pi * hertz, PERIOD)
    fit = fit_axis(answered(hertz, axis), PERIOD, 0.5)
    assert "outside the excited 6 to 158 Hz" in fit.refused["mode_beyond"]
    assert "mode" not in fit.refused, "there is one, which keeps what the rig file says of it"
    assert "mode_frequency_hz" not in fit.found
    assert fit.found["mass"].value == pytest.approx(MASS, rel=0.01)


@pytest.mark.parametrize("guess", [5e-324, 1e300])
def test_a_search_that_goes_astray_ends_in_an_answer_or_a_refusal(guess: float) -> None:
    """One stage of Z led it to a mass below the least number there is."""
    measured, why = response_of(passes(mode=False), PERIOD, LINES, BASE), ""
    try:
        fit_axis(measured, PERIOD, guess)
    except Refused as refused:
        why = str(refused)
    assert not why or "chi^2" in why
