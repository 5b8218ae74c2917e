"""The loop on the stage that is really there: lag, mode and the stiffness of friction at rest, off by the unknown."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.flexible_plant import AxisDynamics, FlexiblePlant
from hil.analysis.frequency_response import LoopResponse, loop_response, measured_finding, read_response
from hil.analysis.loop_corners import CornerFinding, CornerTrial, check_corners
from hil.analysis.pulse_loop import PulseLoop, RigidPlant, loop_of, pulse_and_kick, responses, try_together
from hil.analysis.restoring import Held, pushes_away
from hil.analysis.second_resonance import second_resonances
from hil.analysis.stability import REALISED, check_stability, is_stable, realise_poles
from hil.control.laws import make_law
from hil.control.nominal_model import rig_model
from hil.operate.check_loop import asked_note
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.evidence.stages import only
from tests.support.paths import RIGS

PERIOD = 1e-3
GUIDES = [f"axes.{axis}.model.presliding=[0.3e-6, 30e-6]" for axis in "xy"]


def rig_of(*changes: str) -> RigConfig:
    return load_rig(RIGS / "paper.toml", list(changes))


Answering = tuple[RigConfig, LoopResponse]


@pytest.fixture(scope="module")
def answering() -> Answering:
    """A rig, and what its loop answers, which takes a second to find."""
    rig = rig_of()
    return rig, loop_response(rig)


def at_rest(found: list[CornerFinding]) -> list[CornerFinding]:
    return [finding for finding in found if finding.at_rest]


def test_without_lag_mode_and_stiffness_the_plant_is_the_rigid_one() -> None:
    rng = np.random.default_rng(1)
    rigid = RigidPlant(np.array([0.02, 0.5]), PERIOD, (1, 2))
    flexible = FlexiblePlant([[AxisDynamics(0.02), AxisDynamics(0.5)]], PERIOD)
    for force in rng.normal(size=(100, 1, 2)):
        rigid.advance(force)
        flexible.advance(force)
    np.testing.assert_allclose(flexible.error, rigid.error, rtol=1e-9)
    np.testing.assert_allclose(flexible.rate, rigid.rate, rtol=1e-9)


COUPLED = """
from hil import Law


class Both(Law):
    coupled = True

    def reset(self, position, force): ...

    def force(self, inputs):
        return 1e3 * (inputs.end.position - inputs.position)
"""


@pytest.mark.parametrize(("law", "rows"), [("pd-feedforward", 2), ("./both.py:Both", 3)])
def test_the_last_plant_of_every_copy_is_left_alone(law: str, rows: int, tmp_path: Path) -> None:
    """A law that looks at all axes at once has a plant for every axis that is pulsed, any other law one for all."""
    (tmp_path / "both.py").write_text(COUPLED)
    (tmp_path / "rig.toml").write_text((RIGS / "paper.toml").read_text())
    rig = load_rig(tmp_path / "rig.toml", [f"law.name={law}", "law.gains={}"])
    loop = PulseLoop(rig, rig_model(rig), copies=3)
    assert loop.shape == (3 * rows, 2)
    alone = loop.alone(np.arange(3.0 * rows * 2).reshape(loop.shape))
    assert (alone[:, 0] / 2).tolist() == [rows - 1, 2 * rows - 1, 3 * rows - 1]
    pulsed = loop.pulse()
    assert not loop.alone(pulsed).any()
    assert (loop.beyond(pulsed) == 1.0).all()
    assert np.count_nonzero(pulsed) == 3 * 2


def test_a_sampled_mass_behind_a_hold_answers_as_the_textbook_says() -> None:
    """T^2 / (2 m) (z + 1) / (z - 1)^2."""
    omega = 2.0 * np.pi * np.array([1.0, 40.0, 333.0])
    z = np.exp(1j * omega * PERIOD)
    expected = PERIOD**2 / (2.0 * 0.5) * (z + 1.0) / (z - 1.0) ** 2
    np.testing.assert_allclose(AxisDynamics(0.5).response(omega, PERIOD), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("axis", "expected_hz"),
    [
        (AxisDynamics(0.5, mode_hz=150.0, mode_load=0.3), 150.0 / 0.7**0.5),  # free: the motor swings against the tool
        (AxisDynamics(0.5, stiffness=0.5 * (2 * np.pi * 134.0) ** 2), 134.0),  # stuck on its friction
    ],
)
def test_an_axis_rings_where_the_textbook_says(axis: AxisDynamics, expected_hz: float) -> None:
    eigenvalues = np.linalg.eigvals(axis.step_matrices(PERIOD)[0])
    frequencies = np.abs(np.angle(eigenvalues)) / (2 * np.pi * PERIOD)
    assert frequencies.max() == pytest.approx(expected_hz, rel=1e-9)


def test_a_lag_answers_a_step_exponentially() -> None:
    """v = F/m (t - tau (1 - exp(-t/tau)))."""
    plant, lag, mass = FlexiblePlant([[AxisDynamics(0.5, lag=3e-3)]], PERIOD), 3e-3, 0.5
    for _ in range(10):
        plant.advance(np.ones((1, 1)))
    assert plant.rate[0, 0] == pytest.approx((10e-3 - lag * (1 - np.exp(-10e-3 / lag))) / mass, rel=1e-9)


@pytest.mark.parametrize("part", [0.0, 0.3, 1.0, 1.7, -0.4])
def test_positions_that_are_told_late_answer_late(part: float) -> None:
    """By periods; against the same axis walked in tenths of one, under forces that are held for a whole one."""
    axis, hertz, steps = AxisDynamics(0.9, 3e-4, 120.0, 0.2, 0.3, 40.0, 2e5, 60.0), 70.0, 10
    a, b = axis.step_matrices(PERIOD / steps)
    n, state, motor = 4000, np.zeros(5), []
    force = np.exp(2j * np.pi * hertz * PERIOD * np.arange(n))
    state = state.astype(complex)
    for k in range(n):
        for _ in range(steps):
            motor.append(state[1])
            state = a @ state + b * force[k]
    at = n - 100
    sampled = motor[round((at - part) * steps)] / force[at]
    answer = axis.response(np.array([2.0 * np.pi * hertz]), PERIOD, part * PERIOD)[0]
    assert answer == pytest.approx(sampled, rel=1e-6)


def test_the_nominal_corner_is_the_plain_check() -> None:
    rig = rig_of("axes.x.model.viscous=0", "axes.y.model.viscous=0")
    plain = check_stability(rig).axes
    nominal = [finding for finding in check_corners(rig) if finding.nominal]
    assert [finding.axis for finding in nominal] == ["x", "y"]
    for finding in nominal:
        axis = plain[finding.axis]
        assert axis.gain_margin is not None
        assert finding.gain_db == pytest.approx(20 * np.log10(axis.gain_margin), abs=0.05)
        assert finding.phase_deg == pytest.approx(axis.phase_margin_deg, abs=0.5)


def test_a_lighter_axis_has_that_much_less_margin() -> None:
    found = {(f.axis, f.corner): f for f in check_corners(rig_of())}
    lost = found["x", "as the model says"].gain_db - found["x", "mass -20%"].gain_db
    assert lost == pytest.approx(20 * np.log10(1 / 0.8), abs=0.1)


def test_a_stage_that_says_nothing_of_presliding_has_no_corner_at_rest() -> None:
    assert not at_rest(check_corners(rig_of()))


def test_gains_for_motion_ring_on_a_stiff_guide() -> None:
    """At rest the axis hangs on its friction as on a spring, and the spring is a mode that PD was not tuned for."""
    found = at_rest(check_corners(rig_of("law.name=pd-feedforward", *GUIDES), 1000))
    ringing = [finding for finding in found if not finding.stable]
    assert ringing
    assert all("um of presliding" in finding.lacks(least=True) for finding in ringing)
    assert any(finding.stable for finding in found)  # and a soft guide is none of its troubles


def measured_axis(free_hz: float, known: float = 1.0) -> RigConfig:
    """The microscope, its X as identified: half widths of 2 % of mass and resonance and 5 % of lag, known less well by
    the other argument.
    """
    mode_hz = free_hz * 0.7**0.5  # with a held motor, of 30 % load
    changes = ["law.name=presliding-kalman", "axes.x.model.presliding=[0.3e-6, 30e-6]"]
    for key, value, share in (("mass", 0.9, 0.02), ("mode_frequency_hz", mode_hz, 0.02), ("torque_lag", 2e-4, 0.05)):
        changes.append(f"axes.x.model.{key}={value}")
        changes.append(f"axes.x.measured.{key}=[{value}, {(2.0 - known) * share * value}]")
    return load_rig(RIGS / "microscope.toml", changes)


@pytest.mark.long
@pytest.mark.parametrize("free_hz", [150, 250])
def test_a_loop_that_lives_on_its_mode_has_settled_on_it_before_its_pulse(free_hz: int) -> None:
    """On a rigid axis it is unstable. Where it settled there, it still swung by 0.1 mm when the pulse came, and its
    friction weights learnt from that: margins of 0.3 to 3 dB at 30 Hz, which no stage showed.
    """
    rig = measured_axis(free_hz)
    model, loop = rig_model(rig), PulseLoop(rig, rig_model(rig))
    _, rigid = responses(loop, RigidPlant(model.mass, loop.period, loop.shape), REALISED)
    assert not is_stable(rigid[:, 0, 0], realise_poles(rigid[:, 0, 0]))
    plain, found = check_stability(rig).axes["x"], [one for one in check_corners(rig) if one.axis == "x"]
    assert plain.stable
    assert (plain.gain_db, plain.phase_deg) == pytest.approx((found[0].gain_db, found[0].phase_deg), abs=0.5)
    assert [finding.lacks() for finding in found if finding.lacks()] == []


def test_margins_do_not_hang_on_where_a_learnt_wave_lies_between_the_frequencies_looked_at() -> None:
    """At the wave's own frequency the loop gain is without bound, and it has turned round a fraction of a Hz later. A
    straight line from one side to the other passed by -1: 1.4 dB at 16 Hz, for friction that varies over 1.9 mm alone.
    """
    found = []
    for period in (1.9e-3, 1.92e-3):
        wave = ["law.name=presliding-kalman", f"axes.x.model.friction_period={period}"]
        rig = only(load_rig(RIGS / "microscope.toml", wave), ["x"])
        trial = CornerTrial(rig)
        try_together(loop_of(rig, [trial]), [trial])
        second = [one.gain_db for one in second_resonances(trial) if not one.unstable_hz]
        found.append([*(one.gain_db for one in trial.findings() if not one.at_rest), *second])
    assert np.ptp(found, axis=0).max() < 0.3


def test_of_a_measured_axis_a_smaller_nominal_margin_is_asked_for() -> None:
    lacking = CornerFinding("x", "as the model says", False, True, True, 4.4, 30.0, 150.0)
    for measured, least in ((False, 6.0), (True, 4.5)):
        finding = replace(lacking, measured=measured)
        assert finding.shortfall() == f"a gain margin of 4.4 dB (at least {least:g}) at 150 Hz"
        assert replace(finding, gain_db=least).shortfall() == ""
        assert replace(finding, nominal=False, gain_db=3.0).shortfall() == ""


@pytest.mark.slow
@pytest.mark.parametrize("known", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("free_hz", [150, 175, 190, 210, 240, 300, 360])
def test_the_law_for_guides_has_the_margins_of_a_measured_axis(free_hz: int, known: float) -> None:
    """4.5 dB and 30 degrees nominal, 3 dB and 15 degrees in the measured corners, 4.5 dB at rest; lag 0.2 ms."""
    rig = measured_axis(free_hz, known)
    assert rig.axes["x"].tolerances.known == pytest.approx(known)
    found = [finding for finding in check_corners(rig) if finding.axis == "x"]
    assert [finding.lacks() for finding in found if finding.lacks()] == []


@pytest.mark.slow
@pytest.mark.parametrize("free_hz", [0, 150, 160, 175, 190, 210, 240, 300, 360])
def test_the_law_for_guides_has_its_margins_in_every_corner_of_the_microscope(free_hz: int) -> None:
    """6 dB and 30 degrees nominal, 3 dB and 15 degrees off it, 4.5 dB at rest; lag 0.2 ms. Modes of the free axis, at
    and between those that the gains are given for (hil/control/laws/presliding_gains.py).
    """
    mode_hz = free_hz * 0.7**0.5  # with a held motor, of 30 % load
    changes = ["law.name=presliding-kalman"]
    for axis in ("x", "y", "z"):
        model = f"axes.{axis}.model"
        changes += [
            f"{model}.presliding=[0.3e-6, 30e-6]",
            f"{model}.mode_frequency_hz={mode_hz}",
            f"{model}.torque_lag=2e-4",
        ]
    rig = load_rig(RIGS / "microscope-ideal.toml", changes)
    found = [finding for finding in check_corners(rig) if finding.axis != "theta"]
    assert len(found) >= 3 * (5 + 13)
    assert [finding.lacks() for finding in found if finding.lacks()] == []


@pytest.mark.long
@pytest.mark.parametrize("rig", sorted(path.stem for path in RIGS.glob("*.toml")))
def test_a_rig_we_ship_has_the_margins_that_are_asked_for(rig: str) -> None:
    found = check_corners(load_rig(RIGS / f"{rig}.toml"))
    assert found
    assert [finding.lacks() for finding in found if finding.lacks()] == []


@pytest.mark.long
def test_what_the_law_has_learnt_changes_no_margin() -> None:
    rig = load_rig(RIGS / "paper.toml", ["law.name=presliding-kalman", *GUIDES])
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    fresh = make_law(rig.law, rig_model(rig), PERIOD, limit).learnt_state()
    state = (np.array(fresh).T + 0.1).tolist()
    learnt = rig.model_copy(update={"law": rig.law.model_copy(update={"learnt_state": state})})
    assert [one.as_json() for one in check_corners(learnt)] == [one.as_json() for one in check_corners(rig)]


def test_the_margins_that_are_asked_for_are_said_with_their_reason() -> None:
    found = [CornerFinding("x", "as the model says", False, True, True, 7.0, 40.0, 50.0, measured=True)]
    words = asked_note("pid", found)
    assert words.startswith("asked of pid: 6 dB and 30 deg as the model says, since that may be off (x, measured: 4.5")
    assert "friction holds" not in words
    assert "4.5 dB where friction holds the axis" in asked_note("pid", [replace(found[0], at_rest=True)])


def write_response(path: Path, frequency: np.ndarray, response: np.ndarray) -> Path:
    rows = [f"{f},{abs(p)},{np.degrees(np.angle(p))}" for f, p in zip(frequency, response, strict=True)]
    path.write_text("frequency_hz,magnitude,phase_deg\n" + "\n".join(rows) + "\n")
    return path


def test_the_models_own_response_measured_changes_nothing(tmp_path: Path, answering: Answering) -> None:
    rig, response = answering
    path = write_response(tmp_path / "x.csv", response.frequency_hz, response.plant[:, 0])
    nominal = next(finding for finding in check_corners(rig, 4000) if finding.nominal)
    found = measured_finding(rig, response, "x", path)
    assert found.stable
    assert found.gain_db == pytest.approx(nominal.gain_db, abs=0.05)
    assert found.phase_deg == pytest.approx(nominal.phase_deg, abs=0.5)


def test_a_response_counts_from_its_first_to_its_last_frequency_and_between_them(
    tmp_path: Path, answering: Answering
) -> None:
    """Where the phase turns, nothing was measured but a point below and one above it: the margin lies between."""
    rig, response = answering
    hz = response.frequency_hz
    turns = measured_finding(rig, response, "x", write_response(tmp_path / "x.csv", hz, response.plant[:, 0]))
    below, above = hz < 0.8 * turns.frequency_hz, hz > 1.2 * turns.frequency_hz
    for kept, more in ((below, np.argmax(above)), (above, np.flatnonzero(below)[-1])):
        gains = []
        for chosen in (kept, kept | (np.arange(len(hz)) == more)):
            path = write_response(tmp_path / "x.csv", hz[chosen], response.plant[chosen, 0])
            gains.append(measured_finding(rig, response, "x", path).gain_db)
        assert gains[0] > 30.0
        assert gains[1] == pytest.approx(turns.gain_db, abs=0.5)


def test_three_frequencies_within_the_loops_are_needed(tmp_path: Path, answering: Answering) -> None:
    rig, response = answering
    step = response.frequency_hz[1] - response.frequency_hz[0]
    path = write_response(tmp_path / "x.csv", 100.0 + step * np.array([-1.0, 0.0, 1.0]), np.full(3, 1e-3))
    assert measured_finding(rig, response, "x", path).axis == "x"
    path = write_response(tmp_path / "x.csv", 100.0 + step * np.array([-0.9, 0.0, 1.0]), np.full(3, 1e-3))
    with pytest.raises(RigError, match=r"99.775 to 100.25 Hz; allowed: below 500 Hz"):
        measured_finding(rig, response, "x", path)


def test_a_measured_mode_that_the_model_does_not_know_is_refused_with_its_frequency(
    tmp_path: Path, answering: Answering
) -> None:
    rig, response = answering
    mass = rig.axes["x"].model.mass
    stage = AxisDynamics(mass, mode_hz=240.0, mode_damping=0.005, mode_load=0.3)
    measured = stage.response(2 * np.pi * response.frequency_hz, rig.period_ns * 1e-9)
    found = measured_finding(rig, response, "x", write_response(tmp_path / "x.csv", response.frequency_hz, measured))
    assert not found.stable
    assert 200 < found.frequency_hz < 320
    assert "measured (x.csv)" in found.lacks(least=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f,m,p\n1,1,1\n", "the first line has to be frequency_hz,magnitude,phase_deg"),
        ("frequency_hz,magnitude,phase_deg\n1,1,1\n2,x,1\n", "line 3: '2,x,1' is not three numbers"),
        *(
            (f"frequency_hz,magnitude,phase_deg\n1,1,1\n{row}\n", "line 3: frequency and magnitude have to be positive")
            for row in ("0,1,1", "inf,1,1", "nan,1,1", "2,0,1", "2,inf,1", "2,nan,1", "2,1,inf", "2,1,-inf", "2,1,nan")
        ),
        ("frequency_hz,magnitude,phase_deg\n2,1,1\n1,1,1\n", "line 3: frequency 1 is not above 2"),
        ("frequency_hz,magnitude,phase_deg\n1,1,1\n", "1 frequencies; at least 3"),
    ],
)
def test_a_damaged_response_is_refused_by_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.csv"
    path.write_text(text)
    with pytest.raises(RigError, match=message):
        read_response(path)


def test_a_response_of_just_the_bounds_is_read_and_one_beyond_them_is_not(tmp_path: Path) -> None:
    """100 000 lines, and 8 MiB, nearly all of it in the spaces behind 127 numbers."""
    path, header = tmp_path / "x.csv", "frequency_hz,magnitude,phase_deg\n"
    for lines, reason in ((100_000, "line 2: 'x' is not three numbers"), (100_001, "100001 lines: at most 100000")):
        path.write_text(header + "x\n" * (lines - 1))
        with pytest.raises(RigError, match=reason):
            read_response(path)
    wide = [f"{k},1,0".ljust(65535) + "\n" for k in range(1, 129)]
    text = header + "".join(wide)[: (8 << 20) - len(header) - 1] + "\n"
    path.write_text(text)
    assert path.stat().st_size == 8 << 20
    assert len(read_response(path)[0]) == 128
    path.write_text(text + " ")
    with pytest.raises(RigError, match=r"x\.csv: "):
        read_response(path)


def test_a_presliding_range_is_checked() -> None:
    for value in ("[1e-6]", "[2e-6, 1e-6]", "[0, 1e-6]"):
        with pytest.raises(RigError, match="presliding"):
            rig_of(f"axes.x.model.presliding={value}")


def test_trials_of_one_loop_do_not_see_each_other() -> None:
    rig = rig_of(*GUIDES)
    alone, beside, held = CornerTrial(rig, REALISED), CornerTrial(rig, REALISED), Held()
    try_together(loop_of(rig, [alone]), [alone])
    together = pulse_and_kick(rig, 400, [held, beside])
    for one, other in zip(pulse_and_kick(rig, 400), together, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(alone.answer, beside.answer)
    np.testing.assert_array_equal(alone.motion, beside.motion)
    assert alone.findings() == beside.findings()
    assert held.verdict(rig).tolist() == pushes_away(rig).tolist()


def test_a_further_mass_rings_where_the_textbook_says() -> None:
    """On a rigid axis it is the tool by another name; beside a tool the poles are those of three masses and springs."""
    tool = AxisDynamics(0.5, 2e-4, 150.0, 0.01, 0.3)
    other = AxisDynamics(0.5, 2e-4, others=((150.0, 0.01, 0.3),))
    omega = 2.0 * np.pi * np.geomspace(5.0, 490.0, 60)
    np.testing.assert_allclose(other.response(omega, PERIOD), tool.response(omega, PERIOD), rtol=1e-8)
    both = AxisDynamics(0.5, mode_hz=120.0, mode_load=0.3, others=((280.0, 0.0, 0.06), (400.0, 0.0, 0.03)))
    parts, hertz = np.array([0.61, 0.3, 0.06, 0.03]), np.array([120.0, 280.0, 400.0])
    springs = parts[1:] * (2.0 * np.pi * hertz) ** 2
    stiff = np.diag([springs.sum(), *springs])
    stiff[0, 1:] = stiff[1:, 0] = -springs
    expected = np.sqrt(np.linalg.eigvals(stiff / parts[:, None]).real.clip(min=0.0)) / (2.0 * np.pi)
    found = np.abs(np.angle(np.linalg.eigvals(both.step_matrices(PERIOD)[0]))) / (2.0 * np.pi * PERIOD)
    for one in expected[expected > 1.0]:
        assert np.abs(found - one).min() < 1e-6 * one


def test_axes_with_and_without_a_further_mass_step_beside_each_other() -> None:
    """Room that weigh nothing change nothing."""
    with_one, without = AxisDynamics(0.5, others=((280.0, 0.01, 0.06),)), AxisDynamics(0.5, 2e-4, 120.0, 0.02, 0.3)
    both, alone = FlexiblePlant([[with_one, without]], PERIOD), FlexiblePlant([[without]], PERIOD)
    both.place(np.array([[1e-6, 1e-6]]), np.zeros((1, 2)))
    alone.place(np.array([[1e-6]]), np.zeros((1, 1)))
    for tick in range(200):
        force = np.array([[1.0, 1.0]]) * (tick < 3)
        both.advance(force)
        alone.advance(force[:, 1:])
        np.testing.assert_allclose(both.error[0, 1], alone.error[0, 0], rtol=1e-12)


def test_what_is_missing_is_never_rounded_up_to_what_is_asked() -> None:
    finding = CornerFinding("x", "as the model says", False, True, True, 5.97, 29.7, 100.0)
    for told in ("a gain margin of 5.9 dB (at least 6)", "a phase margin of 29 deg (at least 30)"):
        assert told in finding.shortfall()
