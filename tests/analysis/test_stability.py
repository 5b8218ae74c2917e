"""The sampled-data check: the paper's gains fail at 1 kHz, ours do not, and the poles are those of the equations."""

import numpy as np
import pytest

from hil.analysis import stability
from hil.analysis.pulse_loop import pulse_response
from hil.analysis.stability import (
    REALISED,
    AxisStability,
    LoopMargins,
    StabilityReport,
    check_stability,
    decibels,
    finite_difference_lowest_rate,
    finite_difference_poles,
    is_stable,
    margins,
    margins_of_loop,
    realise_poles,
    refuse_unstable,
)
from hil.control.estimator.gains import design_gains
from hil.control.nominal_model import rig_model
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.tune.objective import margins_of
from tests.support.paths import ROOT

RIG = ROOT / "deploy" / "rigs" / "paper.toml"
PAPER = [(0.022180, 3000.0, 20.0, 1296.0), (0.011386, 3500.0, 25.0, 2842.0)]
PAPERS_GAINS = ["law.gains.kp=[3000, 3500]", "law.gains.kd=[20, 25]"]


@pytest.mark.parametrize(("mass", "kp", "kd", "lowest"), PAPER)
def test_the_papers_gains_are_stable_only_from_their_lowest_rate_on(
    mass: float, kp: float, kd: float, lowest: float
) -> None:
    assert finite_difference_lowest_rate(mass, kp, kd) == pytest.approx(lowest, rel=0.02)
    assert max(map(abs, finite_difference_poles(mass, kp, kd, 1e-3))) > 1.0
    assert max(map(abs, finite_difference_poles(mass, kp, kd, 0.95 / lowest))) < 1.0


def pd_poles(rig: RigConfig, kp: float, kd: float, axis: int) -> list[complex]:
    """By hand: plant [e, v], force under way, and the rig's filter [e, v, d] with its prediction over one period."""
    mass, t = float(rig_model(rig).mass[axis]), rig.period_ns * 1e-9
    k1, k2, k3 = design_gains(rig)[0][:, axis]
    a, b = np.array([[1.0, t], [0.0, 1.0]]), np.array([t * t / 2, t]) / mass
    f = np.block([[a, -b[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])
    b3, gain = np.append(b, 0.0), np.array([k1, k2, k3])
    # z = [plant at the sample, force in the last interval u1, filter before its update], all at the new sample
    h = np.array([1.0, 0.0, 0.0])
    update = np.eye(3) - np.outer(gain, h)
    ahead = f @ update
    row = -np.array([kp, kd, 0.0])
    m = np.zeros((6, 6))
    m[:2, :2], m[:2, 2] = a, b
    m[2, 0] = row @ f @ gain
    m[2, 2] = row @ b3
    m[2, 3:] = row @ ahead
    m[3:, 0] = f @ gain
    m[3:, 2] = b3
    m[3:, 3:] = ahead
    return sorted((complex(z) for z in np.linalg.eigvals(m)), key=abs, reverse=True)


def test_realised_poles_of_the_rigs_loop_are_those_of_its_equations() -> None:
    rig = load_rig(RIG, ["law.gains.kp=[2000, 1000]", "law.gains.kd=[9, 5]"])
    report = check_stability(rig)
    for axis, (name, kp, kd) in enumerate([("x", 2000.0, 9.0), ("y", 1000.0, 5.0)]):
        expected = pd_poles(rig, kp, kd, axis)
        found = report.axes[name].poles
        assert (report.axes[name].lowest_stable_rate_hz, report.axes[name].finite_difference_rate_hz) == (None, None)
        assert abs(found[0]) == pytest.approx(abs(expected[0]), abs=1e-4)
        assert abs(found[2]) == pytest.approx(abs(expected[2]), abs=1e-3)


@pytest.mark.parametrize("law", ["pd-feedforward", "disturbance-observer"])
def test_what_gravity_pulls_does_not_move_a_pole(law: str) -> None:
    level, steep = (
        check_stability(load_rig(RIG, [f"law.name={law}", f"axes.x.model.gravity={pull}"])).axes["x"] for pull in (0, 2)
    )
    assert np.abs(steep.poles) == pytest.approx(np.abs(level.poles), abs=1e-3)
    assert steep.gain_margin == pytest.approx(level.gain_margin, rel=1e-3)


def test_gain_margin_is_where_the_loop_turns_unstable() -> None:
    rig = load_rig(RIG, ["law.gains.kp=[2000, 1000]", "law.gains.kd=[9, 5]"])
    axis = check_stability(rig).axes["x"]
    assert axis.gain_margin is not None
    assert axis.phase_margin_deg is not None
    assert 20 < axis.phase_margin_deg < 80
    # A plant lighter than the nominal model is a higher loop gain: just inside and just outside the margin.
    inside, _ = pulse_response(rig, 2000, 0.97 * axis.gain_margin)
    outside, _ = pulse_response(rig, 2000, 1.03 * axis.gain_margin)
    assert np.abs(inside[-100:, 0]).max() < 1e-3
    assert not np.abs(outside[-100:, 0]).max() < 1e3


@pytest.mark.long
def test_a_law_that_has_not_settled_yet_has_its_margin_all_the_same() -> None:
    """A slow integrator still takes up friction when the pulse comes; that is no part of the loop's answer."""
    slow, plain = (
        check_stability(load_rig(RIG, changes)).axes["x"]
        for changes in (
            ["law.name=pid", "law.gains.kp=1400", "law.gains.kd=8", "law.gains.ki=3000"],
            ["law.gains.kp=1400", "law.gains.kd=8"],
        )
    )
    assert slow.gain_margin == pytest.approx(plain.gain_margin, rel=0.02)


@pytest.mark.long
def test_a_loop_that_circles_for_ever_is_unstable_though_it_forgets_a_pulse() -> None:
    """Friction's sign taken over a width in which it drives more than the law damps."""
    gains = ["law.gains.kp=1930", "law.gains.kd=6.3", "law.gains.sign_width={}"]
    for width in (0.0451, 0.0454, 0.0457):
        report = check_stability(load_rig(RIG, ["law.name=computed-torque", *(g.format(width) for g in gains)]))
        assert not report.axes["x"].stable
    assert check_stability(load_rig(RIG, ["law.name=computed-torque", *(g.format(0.002) for g in gains)])).stable


@pytest.mark.long
@pytest.mark.parametrize("law", load_rig(RIG).law.tuned)
def test_every_tuned_law_of_the_rig_has_the_textbooks_margins(law: str) -> None:
    rig = load_rig(RIG, [f"law.name={law}"])
    refuse_unstable(rig)
    for axis in check_stability(rig).axes.values():
        margins = margins_of(axis)
        assert margins.gain_db >= 6.0
        assert margins.phase_deg >= 30.0


@pytest.mark.requirement(id="SR-5.5")
def test_an_unstable_loop_is_refused_by_axis_and_pole() -> None:
    with pytest.raises(RigError, match="unstable on axis 'y' at 1000 Hz"):
        refuse_unstable(load_rig(RIG, PAPERS_GAINS))


def test_a_force_that_alternates_unseen_between_samples_is_found() -> None:
    """Damping far too high: every sample falls on a node of the position, only the speed shows it."""
    rig = load_rig(RIG, ["law.gains.kp=[2000, 1000]", "law.gains.kd=[90, 5]"])
    report = check_stability(rig)
    assert not report.axes["x"].stable
    assert report.axes["y"].stable


def test_poles_and_margins_of_a_known_loop() -> None:
    """S of L = 0.5 / (z - 0.5): pole at 0, no crossing of -1 upwards before gain 3."""
    answer = np.zeros(64)
    z_pole, loop_gain = 0.5, 0.5
    state = 0.0
    for k in range(64):  # y = d - L y
        answer[k] = (1.0 if k == 0 else 0.0) - state
        state = z_pole * state + loop_gain * answer[k]
    assert abs(realise_poles(answer + 0.0)[0]) < 1e-6
    up, down, *_ = margins(answer)
    assert up is None or up == pytest.approx(3.0, rel=0.05)
    assert down is None


def test_a_loop_that_was_out_of_range_before_the_pulse_has_no_small_pole() -> None:
    """The pulse is lost in the last digits of what has run away; then that overflows."""
    answer = np.zeros(240)
    answer[100:] = np.nan
    assert abs(realise_poles(answer)[0]) > 1.0


@pytest.mark.parametrize(
    ("up", "down", "phase", "at"),
    [
        (1.5, None, 30.0, 0.1),  # 3.5 of 6 dB, all of 30 degrees
        (None, 0.6, 30.0, 0.1),
        (1.5, 0.1, 10.0, 0.2),  # a third of 30 degrees
        (1.9, None, 27.0, 0.2),  # 5.6 of 6 dB
        (1.9, None, 29.0, 0.1),
        (1.5, None, None, 0.1),
        (None, None, 100.0, 0.2),
    ],
)
def test_margins_are_tightest_where_the_smaller_part_of_six_decibels_or_thirty_degrees_is_left(
    up: float | None, down: float | None, phase: float | None, at: float
) -> None:
    assert LoopMargins(up, down, phase, gain_at=0.1, phase_at=0.2).tightest_at == at


@pytest.mark.parametrize("turned", [0.5, 1.5, 3.0])
def test_a_loop_gain_without_bound_between_two_frequencies_is_no_margin(turned: float) -> None:
    """S is 0 at 16.3 Hz. A straight line between L on both sides passes by -1."""
    frequency = np.arange(15.0, 18.0, 0.5)
    beside = frequency - 16.3
    sensitivity = 0.05 * beside * np.exp(1j * (turned + 0.1 * beside))
    assert margins_of_loop(1.0 / sensitivity - 1.0, frequency).gain_db > 40.0


def test_margins_are_those_of_loops_whose_margins_are_known() -> None:
    """2/3 / (s (s + 1)^2) turns at 1 rad/s, where it is 1/3; 2 (s + 1)^2 / s^3 likewise, where it is 4."""
    omega = np.linspace(0.02, 8.0, 100_000)
    s = 1j * omega

    def phase_margin(loop: np.ndarray) -> tuple[float, float]:
        at = int(np.argmin(np.abs(np.abs(loop) - 1.0)))
        return abs(float(np.degrees(np.angle(-loop[at])))), float(omega[at])

    for loop, up, down in ((2.0 / 3.0 / (s * (s + 1.0) ** 2), 3.0, None), (2.0 * (s + 1.0) ** 2 / s**3, None, 0.25)):
        found, (phase, at) = margins_of_loop(loop, omega), phase_margin(loop)
        assert found.gain_up == (up and pytest.approx(up, rel=1e-3))
        assert found.gain_down == (down and pytest.approx(down, rel=1e-3))
        assert found.gain_at == pytest.approx(1.0, abs=2e-3)
        assert found.phase_deg == pytest.approx(phase, abs=0.05)
        assert found.phase_at == pytest.approx(at, abs=2e-3)
    assert margins_of_loop(0.5 / (s + 1.0), omega) == (None, None, None, 0.0, 0.0)


@pytest.mark.parametrize("shift", [0.0, 0.03, 0.05, 0.09])
def test_the_phase_margin_is_that_of_the_crossing_between_two_frequencies(shift: float) -> None:
    frequency = np.exp(np.arange(-1.0 + shift, 1.0, 0.1))  # the loop crosses 1 at a frequency of 1
    loop = 1.0 / (1j * frequency) * np.exp(-0.5j * frequency)
    assert margins_of_loop(loop, frequency).phase_deg == pytest.approx(90.0 - np.degrees(0.5), abs=0.05)


def test_the_answer_of_a_sampled_loop_has_the_margins_of_the_loop() -> None:
    """0.5 / (z - 1), whose gain is 1 where 2 sin(w/2) is 0.5."""
    found = margins(np.array([1.0, *(-(0.5**k) for k in range(1, 1000))]))
    crossing = np.arcsin(0.25) / np.pi  # cycles per sample
    assert found.phase_at == np.floor(1000 * crossing) / 1000
    assert found.phase_deg == pytest.approx(np.degrees(np.pi / 2 - np.pi * crossing), abs=0.2)


@pytest.mark.parametrize(
    ("up", "down", "db"),
    [(10.0, None, 20.0), (None, 0.1, 20.0), (10.0, 0.01, 20.0), (100.0, 0.1, 20.0), (None, None, np.inf)],
)
def test_decibels_are_of_whichever_is_nearer(up: float | None, down: float | None, db: float) -> None:
    assert decibels(up, down) == pytest.approx(db)
    assert AxisStability(True, [], up, down, None).gain_db == pytest.approx(db)


def test_a_report_says_which_axis_is_unstable_from_which_rate_on_it_is_not_and_is_json() -> None:
    lost = AxisStability(False, [1.25 + 0j, 0.5 + 0.25j], None, None, None, 1234.4)
    held = AxisStability(True, [-0.5j], 2.0, 0.25, 45.0, 50.0, 60.0)
    report = StabilityReport("mine", 1000.0, {"x": lost, "y": held})
    line = "law 'mine' is unstable on axis 'x' at 1000 Hz: a pole at |z| = 1.2500"
    assert report.problems() == [line + "; it is stable from 1234 Hz on; lower law.gains or run `hil tune`"]
    for rate in (None, np.inf):  # not asked for, none found
        axis = AxisStability(False, [1.25 + 0j], None, None, None, rate)
        assert StabilityReport("mine", 1000.0, {"x": axis}).problems() == [line + "; lower law.gains or run `hil tune`"]
    assert (report.stable, StabilityReport("mine", 1000.0, {"y": held}).stable) == (False, True)
    assert (lost.phase_deg, held.phase_deg, held.radius) == (np.inf, 45.0, 0.5)
    assert report.as_json() == {
        "law": "mine", "rate_hz": 1000.0, "stable": False,
        "axes": {
            "x": {"stable": False, "radius": 1.25, "poles": [[1.25, 0.0], [0.5, 0.25]], "gain_margin": None,
                  "gain_margin_down": None, "phase_margin_deg": None, "lowest_stable_rate_hz": 1234.4,
                  "finite_difference_rate_hz": None},
            "y": {"stable": True, "radius": 0.5, "poles": [[0.0, -0.5]], "gain_margin": 2.0, "gain_margin_down": 0.25,
                  "phase_margin_deg": 45.0, "lowest_stable_rate_hz": 50.0, "finite_difference_rate_hz": 60.0},
        },
    }  # fmt: skip


def test_the_lowest_stable_rate_is_found_to_a_thousandth_or_said_to_be_none() -> None:
    for mass, kp, kd, _ in PAPER:
        rate = finite_difference_lowest_rate(mass, kp, kd)
        at, below = (max(map(abs, finite_difference_poles(mass, kp, kd, 1.0 / r))) for r in (rate, rate / 1.001))
        assert at < 1.0 <= below + 1e-6
    assert finite_difference_lowest_rate(1.0, 3000.0, 20000.0) == np.inf
    assert finite_difference_lowest_rate(1.0, 1.0, 2.0) == 50.0


def test_every_axis_has_a_lowest_rate_of_its_own_and_a_rate_that_is_refused_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stable_axes(rig: RigConfig) -> np.ndarray:
        if rig.rate_hz < 300.0:
            raise ValueError("a law that refuses such a rate")
        return np.array([rig.rate_hz >= 200.0, rig.rate_hz >= 2000.0])

    monkeypatch.setattr(stability, "_stable_axes", stable_axes)
    axes = check_stability(load_rig(RIG, PAPERS_GAINS), lowest_rate=True, ticks=REALISED).axes
    assert [axes[name].lowest_stable_rate_hz for name in "xy"] == [
        pytest.approx(300.0, rel=1e-3), pytest.approx(2000.0, rel=1e-3)
    ]  # fmt: skip
    assert [axes[name].finite_difference_rate_hz for name in "xy"] == [
        finite_difference_lowest_rate(mass, kp, kd) for mass, kp, kd, _ in PAPER
    ]


@pytest.mark.parametrize(("grows", "stable"), [(0.98, True), (1.0, False), (1.01, False)])
def test_a_motion_that_does_not_fade_is_unstable_whatever_its_poles_say(grows: float, stable: bool) -> None:
    answer = 1e-3 * grows ** np.arange(400.0)
    assert is_stable(answer, [0.5 + 0j]) == stable
    assert not is_stable(answer, [1.0 + 0j])
    assert not is_stable(answer, [0.5 + 0j, -1.0 + 0j])


@pytest.mark.parametrize(("left", "growth", "stable"), [(0.0, 1.0, True), (1e-6, 1.003, False), (1e-4, 1.0, False)])
def test_a_pole_counts_for_nothing_where_the_answer_is_gone(left: float, growth: float, stable: bool) -> None:
    """Where a wave of friction is learnt the loop varies with time, and realising it gave a pole of 1.0029."""
    ticks = np.arange(2000)
    answer = 0.99**ticks + left * growth**ticks
    assert is_stable(answer, [1.0029 + 0.1j]) is stable
    assert not is_stable(answer[:500], [1.0029 + 0.1j]), "too short to tell"
