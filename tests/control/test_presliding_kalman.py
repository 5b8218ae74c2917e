"""The law for guides with presliding: its parts against independent ones. What every law must do is in test_laws.py."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from hil.analysis import frequency_response
from hil.analysis.stability import margins_of_loop
from hil.control.laws.base import Model, axis_inputs
from hil.control.laws.motion_observer import MotionModel, MotionObserver
from hil.control.laws.position_table import PositionTable
from hil.control.laws.presliding_bank import Bank, moved, slopes, weighed
from hil.control.laws.presliding_gains import OF_MODE, SWINGS, of_model
from hil.control.laws.presliding_kalman import PreslidingKalman
from hil.control.laws.weight_regression import Weights, diagonal, learnt
from hil.control.nominal_model import rig_model
from hil.rig.file import load_rig
from tests.support.paths import RIGS

PERIOD, MASS, LAG, LOAD, DAMPING = 1e-3, 0.9, 2e-4, 0.3, 0.02
FORCE_NOISE, DISTURBANCE_NOISE, MODE_NOISE = 3.24, 1.36, 13.1


def model(frequency: float) -> Model:
    return Model(MASS, 0.6, 3.0, 0.0, 0.0, LAG, frequency, DAMPING, LOAD)


@pytest.mark.parametrize("frequency", [0.0, 120.0, 250.0])
def test_observer_is_scipys_kalman_filter_of_the_two_mass_model(frequency: float) -> None:
    """In the two masses' own coordinates: motor and tool on a spring, tuned while the motor is held."""
    tool, motor = LOAD * MASS, (1.0 - LOAD) * MASS
    omega = 2.0 * np.pi * frequency
    free = omega / np.sqrt(1.0 - LOAD)
    stiffness, damper = tool * omega**2, 2.0 * DAMPING * free * tool * motor / MASS  # of the free axis' mode
    if frequency:
        a = np.zeros((6, 6))  # motor, its speed, tool, its speed, force, disturbance
        a[0, 1] = a[2, 3] = 1.0
        a[1] = [-stiffness / motor, -damper / motor, stiffness / motor, damper / motor, 1 / motor, -1 / motor]
        a[3] = [stiffness / tool, damper / tool, -stiffness / tool, -damper / tool, 0.0, 0.0]
        seen, lagged = np.array([[1.0, 0, 0, 0, 0, 0]]), 4
        # Noise of the mode moves encoder and tool against each other about the centre of mass.
        own = np.array([0.0, 1.0, 0.0, -motor / tool, 0.0, 0.0])
    else:
        a = np.zeros((4, 4))
        a[0, 1] = 1.0
        a[1, 2:] = [1 / MASS, -1 / MASS]
        seen, lagged = np.array([[1.0, 0, 0, 0]]), 2
        own = np.zeros(4)
    a[lagged, lagged] = -1.0 / LAG
    transition = expm(a * PERIOD)
    metre = PERIOD**2 / (2.0 * MASS)
    force = -transition[:, -1] / metre * FORCE_NOISE
    force[-1] = 0.0
    q = np.outer(force, force) + np.outer(own, own) * (MODE_NOISE / PERIOD) ** 2
    q[-1, -1] = (DISTURBANCE_NOISE / metre) ** 2
    scale = np.diag([1.0, 1 / PERIOD] * (lagged // 2) + [1 / metre, 1 / metre])
    back = np.linalg.inv(scale)
    p = solve_discrete_are((back @ transition @ scale).T, (seen @ scale).T, back @ q @ back, np.eye(1))
    gain = scale @ (p @ scale @ seen.T / (seen @ scale @ p @ scale @ seen.T + 1.0))[:, 0]
    ours = MotionModel(model(frequency), PERIOD).gains(FORCE_NOISE, DISTURBANCE_NOISE, MODE_NOISE)
    assert [ours.e + ours.x, ours.v + ours.n, ours.d] == pytest.approx([gain[0], gain[1], gain[-1]], rel=1e-6)


def test_the_tool_is_behind_the_encoder_by_what_its_spring_gives() -> None:
    """The tool's mass under an acceleration a bends the spring by a / w^2, w the tool's on a held motor."""
    omega = 2.0 * np.pi * 120.0
    assert MotionModel(model(120.0), PERIOD).tool_lag == pytest.approx(1.0 / omega**2)
    assert MotionModel(model(0.0), PERIOD).tool_lag == 0.0


@pytest.mark.parametrize("frequency", [0.0, 120.0])
def test_what_is_learnt_over_repeats_is_the_error_of_the_tool_not_of_the_encoder(frequency: float) -> None:
    law, acceleration = PreslidingKalman(model(frequency), PERIOD, 10.0), 2.0
    law.learn_repeats(1_000_000_000, 0)
    x = axis_inputs()
    x.fresh, x.position, x.sample.acceleration, x.task_ns = 1.0, 5e-6, acceleration, 0
    law.force(x)
    bent = acceleration / (2.0 * np.pi * frequency) ** 2 if frequency else 0.0
    assert law._observer.e > 1e-6
    assert law._memory is not None
    assert law._memory._squares == pytest.approx((law._observer.e - bent) ** 2)


def test_a_force_that_is_learnt_takes_over_from_the_observer_without_a_jerk() -> None:
    """11 g on a constant force, which the observer holds; then the repeats hold most of it, from their first tick."""
    mass, opposing, repeat = 0.0114, 0.02, 100
    law = PreslidingKalman(Model(mass, 0.0, 0.0, 0.0, 0.0), PERIOD, 5.0)
    law.learn_repeats(repeat * 1_000_000, 0)
    x = axis_inputs()
    x.fresh = x.answered = 1.0
    position, speed, off, learnt = 0.0, 0.0, [], []
    for tick in range(5 * repeat):
        x.task_ns, x.position = tick * 1_000_000, position
        asked = law.force(x)  # acts from the next sample on
        acceleration = (x.force_last - opposing) / mass
        position += PERIOD * speed + 0.5 * PERIOD**2 * acceleration
        speed += PERIOD * acceleration
        x.force_before, x.force_last = x.force_last, asked
        off.append(abs(position))
        learnt.append(law._learnt)
    assert learnt[2 * repeat] > 0.6 * opposing > 0.0 == learnt[2 * repeat - 1]
    assert max(off[2 * repeat :]) < 1e-3 * max(off[:repeat])


@pytest.mark.parametrize("frequency", [0.0, 120.0, 250.0])
def test_a_force_that_was_another_than_expected_is_put_right_by_one_sample(frequency: float) -> None:
    """The drive's force behind the lag was 0.4 N off when it took over: position, speed and mode are those after it."""
    motion = MotionModel(model(frequency), PERIOD)
    axis, observer = MotionObserver(motion, 0.0), MotionObserver(motion, 0.0)
    axis.f = 0.4
    axis.advance(0.0, 0.0)
    observer.advance(0.0, 0.0)
    observer.correct(axis.e + axis.x, motion.thrown)
    assert axis.v == pytest.approx(0.4 * LAG * (1.0 - np.exp(-PERIOD / LAG)) / MASS)
    assert [observer.e, observer.v, observer.x, observer.n] == pytest.approx([axis.e, axis.v, axis.x, axis.n], rel=1e-9)
    assert observer.d == 0.0


def test_the_mode_swings_after_a_throw_by_what_is_said_and_fades_as_is_said() -> None:
    motion = MotionModel(model(120.0), PERIOD)
    axis = MotionObserver(motion, 0.0)
    axis.f = 1.0
    swing = []
    for _ in range(200):
        axis.advance(0.0, 0.0)
        swing.append(abs(axis.x))
    assert max(swing) == pytest.approx(motion.swing, rel=0.05)
    assert max(swing[101:]) == pytest.approx(motion.swing * motion.fade**101, rel=0.1)
    assert MotionModel(model(0.0), PERIOD).swing == 0.0
    undamped = model(120.0)
    undamped.mode_damping = 0.0
    assert MotionModel(undamped, PERIOD).fade < 1.0


def test_gains_of_floats_and_of_arrays_are_the_same_bits() -> None:
    def column(value: float) -> Any:
        return np.array([value, value])

    arrays = Model(*(column(value) for value in (MASS, 0.6, 3.0, 0.0, 0.0, LAG, 0.0, DAMPING, LOAD)))
    arrays.mode_frequency = np.array([0.0, 250.0])
    noises = (FORCE_NOISE, DISTURBANCE_NOISE, MODE_NOISE)
    both = MotionModel(arrays, PERIOD).gains(*map(column, noises))
    for i, frequency in enumerate((0.0, 250.0)):
        one = MotionModel(model(frequency), PERIOD).gains(*noises)
        assert (one.e, one.v, one.x, one.n, one.d) == tuple(getattr(both, name)[i] for name in "evxnd")


def test_a_rigid_axis_whose_model_states_presliding_integrates_more_slowly() -> None:
    """Of three axes: rigid without and with presliding, and one with a mode and presliding; as floats and as arrays."""
    swings, presliding, zeros = np.array([0.0, 0.0, 0.2]), np.array([0.0, 20e-6, 20e-6]), np.zeros(3)
    both = of_model("integral", swings, presliding, zeros)
    assert both.tolist() == [0.1, 0.06, 0.08]
    assert [
        of_model("integral", s, d, 0.0) for s, d in zip(swings.tolist(), presliding.tolist(), strict=True)
    ] == both.tolist()
    assert of_model("bandwidth", swings, presliding, zeros).tolist() == [0.2228, 0.2228, 0.1488]
    stated, ideal = (rig_model(load_rig(RIGS / f"{name}.toml")) for name in ("microscope", "microscope-ideal"))
    assert list(zip(stated.presliding_least, stated.presliding_greatest, strict=True))[2:] == [
        (3e-6, 20e-6),
        (3e-6, 12e-6),
    ]
    assert not any(ideal.presliding_greatest)


def test_the_gains_follow_how_well_a_mode_is_known() -> None:
    """Of a rigid axis nothing changes. Half known is half way between what nobody knows and what was measured. Where
    nothing is known, each gain is that of the table, to the bit.
    """
    swings = np.array([0.0, 0.15, 0.2, 0.2])
    assert of_model("bandwidth", swings, np.zeros(4), np.array([1.0, 1.0, 1.0, 0.5])).tolist() == pytest.approx(
        [0.2228, 0.1931, 0.2098, 0.5 * (0.1488 + 0.2098)]
    )
    assert of_model("integral", 0.2, 0.0, 1.0) == of_model("integral", 0.2, 0.0, 0.0) == 0.08
    for name, (_, flexible) in OF_MODE.items():
        assert of_model(name, SWINGS[0], 0.0, 0.0) == flexible[0]


def test_operators_turn_round_over_their_reach() -> None:
    """Dahl's curve after a reversal, 1 - 2 exp(-x / D), in steps small against D."""
    z: Bank = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    slope = slopes(1e-6)
    for _ in range(20_000):
        z = moved(z, slope, -1e-10)
    expected = [2.0 * np.exp(-2e-6 * s) - 1.0 for s in slope]
    assert z == pytest.approx(expected, abs=1e-3)


def test_weights_become_those_of_the_process() -> None:
    rng, truth = np.random.default_rng(1), np.array([0.1, -0.2, 0.3, 0.0, 0.5, 0.4, -0.1])
    ones: Weights = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    none: Weights = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    spread, w = diagonal(ones), np.zeros(7)
    for _ in range(500):
        r = rng.normal(size=7)
        spread, k = learnt(spread, tuple(r.tolist()), 1e-4, none, ones, 1.0)
        w += np.array(k) * (r @ (truth - w) + 1e-2 * rng.normal())
    assert w == pytest.approx(truth, abs=5e-3)


@pytest.mark.parametrize("learn", [1.0, 0.0])
def test_a_step_of_the_weights_filter_is_the_textbooks(learn: float) -> None:
    """P - h h' / (r' P r + noise), and the walk of every weight that is less certain than it may be."""
    rng, at = np.random.default_rng(3), np.triu_indices(7)
    for _ in range(20):
        root, r, more = rng.normal(size=(7, 7)), rng.normal(size=7), rng.uniform(0.1, 0.2, size=7)
        p, noise = root @ root.T, 0.3
        most = np.diag(p) * rng.choice([0.9, 1.1], size=7)
        told = (tuple(values.tolist()) for values in (p[at], r))
        spread, k = learnt(*told, noise, tuple(more.tolist()), tuple(most.tolist()), learn)
        gain = learn * p @ r / (r @ p @ r + noise)
        expected = p - np.outer(gain, p @ r) + learn * np.diag(np.where(np.diag(p) < most, more, 0.0))
        assert spread == pytest.approx(expected[at])
        assert k == pytest.approx(gain)
    variances = tuple(float(v) for v in range(1, 8))
    assert diagonal(variances) == tuple(np.diag(variances)[at].tolist())


def test_what_is_learnt_of_a_place_counts_once_the_place_is_left() -> None:
    table = PositionTable(1e-3, 1.0)
    for k in range(11):
        table.add(2e-3 + 1e-4 * k, 0.05)
        assert table.at(2e-3) == table.at(3e-3) == 0.0 or k == 10
    for k in range(11):
        table.add(3e-3 + 1e-4 * k, 0.0)
    assert table.at(2e-3) == pytest.approx(0.05 * 5.5)
    assert table.at(3e-3) == pytest.approx(0.05 * 5.5)
    assert table.at(2.5e-3) == pytest.approx(0.05 * 5.5)
    assert table.at(5e-3) == table.at(-2e-3) == 0.0


def test_at_the_modes_that_gains_are_given_for_they_keep_the_margins_and_give_none_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """6 dB and 30 degrees as the model says; the search for the least error left the loop right at them."""
    monkeypatch.setattr(frequency_response, "TICKS", 500)
    sets = ["law.name=presliding-kalman"]
    for axis, swings in zip(("x", "y", "z", "theta"), SWINGS, strict=True):
        key = f"axes.{axis}.model"
        sets += [f"{key}.mode_frequency_hz={swings / PERIOD * (1.0 - LOAD) ** 0.5}", f"{key}.torque_lag={LAG}"]
        sets += [f"{key}.presliding=[0.3e-6, 30e-6]"]
    found = frequency_response.loop_response(load_rig(RIGS / "microscope-ideal.toml", sets))
    for at in range(len(SWINGS)):
        met = margins_of_loop(found.loop[:, at], found.frequency_hz)
        assert met.phase_deg is not None
        assert 6.0 <= met.gain_db <= 6.5
        assert 30.0 <= met.phase_deg <= 33.0


def test_learnt_friction_never_pushes_behind_a_reversal() -> None:
    """Innovations with a bias, as of a mode that rings on short moves, would make the learnt stiffness negative: the
    integral through it would have the wrong sign. It stays at what the law takes for soft.
    """
    law = PreslidingKalman(model(200.0), PERIOD, 10.0)
    weights, slope = law._weights, slopes(0.3e-6)
    softest = 0.6 * slope[4]
    stiffness = []
    for tick in range(4_000):
        place = 2e-6 * np.sin(0.3 * tick)
        bank = moved((0.0,) * 6, slope, place)
        weights.fed(bank, 0.0)
        weights.learn(place, 2e-9 * np.sign(np.cos(0.3 * tick)), 1.0, law._moving)
        stiffness.append(weighed(weights.friction(), slope))
    assert min(stiffness) == pytest.approx(softest)
    assert sum(found == pytest.approx(softest) for found in stiffness) > 100


def test_while_the_mode_rings_the_table_learns_nothing() -> None:
    """Of fast short moves. On a rigid axis the steps of the force count, and only for some periods."""
    for frequency in (0.0, 200.0):
        law = PreslidingKalman(model(frequency), PERIOD, 10.0)
        weights = law._weights
        for tick in range(200):
            weights.fed((0.5, 0.5, 0.5, 0.5, 0.5, 0.5), 10.0 if tick % 4 < 2 else -10.0)
            weights.learn(0.0, 0.0, 1.0, law._moving)
        assert weights.calm() < 0.01
        for _ in range(60):
            weights.fed((0.5, 0.5, 0.5, 0.5, 0.5, 0.5), -10.0)
            weights.learn(0.0, 0.0, 1.0, law._moving)
        assert (weights.calm() > 0.99) == (frequency == 0.0)


def guided(presliding: float) -> Model:
    known = model(0.0)
    known.presliding_greatest = presliding
    return known


def _on_a_spring(ramp: float, presliding: float = 20e-6) -> list[float]:
    """Positions, m, of an axis that friction holds at rest as a spring. A force that changes evenly, as friction does
    that gives way, pulls at it.
    """
    stiffness, damping, pull, parts = 6e4, 140.0, 0.2, 20  # N/m, N s/m, N/s; of a period
    law = PreslidingKalman(guided(presliding), PERIOD, 10.0, ramp=ramp)
    x = axis_inputs()
    x.fresh = x.answered = 1.0
    position, speed, positions = 0.0, 0.0, []
    for tick in range(600):
        x.position = position
        asked = law.force(x)  # acts from the next sample on
        for part in range(parts):
            opposing = stiffness * position + damping * speed - pull * PERIOD * (tick + part / parts)
            speed += PERIOD / parts * (x.force_last - opposing) / MASS
            position += PERIOD / parts * speed
        x.force_before, x.force_last = x.force_last, asked
        positions.append(position)
    return positions


def test_at_rest_the_integral_follows_friction_that_gives_way() -> None:
    """Without the ramp the axis creeps behind by a steady error; with it, most of that is gone 0.35 s later."""
    behind = _on_a_spring(0.0)
    assert _on_a_spring(0.01, presliding=0.0) == _on_a_spring(0.0, presliding=0.0)  # on ideal friction it would hunt
    followed = _on_a_spring(0.01)
    steady = sum(behind[350:]) / len(behind[350:])
    assert steady > 20e-9
    assert abs(sum(followed[350:])) / len(followed[350:]) < 0.2 * steady


def test_what_is_no_creep_winds_up_no_ramp() -> None:
    """An error beyond half the finest reach is an arrival or a step; and in motion there is none."""
    law = PreslidingKalman(guided(20e-6), PERIOD, 10.0)
    x = axis_inputs()
    x.fresh = x.answered = 1.0
    for position, winds in ((0.4e-6, False), (0.02e-6, True)):
        x.position = position
        for _ in range(30):
            law.force(x)
        assert (law._creep != 0.0) == winds
    x.start.velocity = x.end.velocity = 1e-3
    law.force(x)
    assert law._creep == 0.0
