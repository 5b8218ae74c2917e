"""Mass, lag and mode from a multisine on two masses that this file integrates; poor data is refused."""

import numpy as np
import pytest

from hil.analysis.flexible_plant import AxisDynamics
from hil.identify.estimate import Refused
from hil.identify.frequency_fit import Pass, Response, fit_axis, response_of

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


def test_an_axis_with_two_resonances_is_refused() -> None:
    hertz = np.arange(6.0, 390.0, 4.0)
    one, other = (AxisDynamics(MASS, LAG, mode, 0.02, 0.2, VISCOUS) for mode in (90.0, 210.0))
    omega = 2.0 * np.pi * hertz
    both = one.response(omega, PERIOD) + other.response(omega, PERIOD)
    with pytest.raises(Refused, match=r"chi\^2 \d+ per degree of freedom .at most 20.: no axis of one mode fits"):
        fit_axis(answered(hertz, both), PERIOD, 0.5)


def test_a_resonance_beyond_the_lines_is_not_told() -> None:
    hertz = np.arange(6.0, 160.0, 2.0)
    axis = AxisDynamics(MASS, LAG, 180.0, 0.02, 0.3, VISCOUS).response(2.0 * np.pi * hertz, PERIOD)
    fit = fit_axis(answered(hertz, axis), PERIOD, 0.5)
    assert "is outside the excited 6 to 158 Hz" in fit.refused["mode"]
    assert "mode_frequency_hz" not in fit.found
    assert fit.found["mass"].value == pytest.approx(MASS, rel=0.01)
