"""The motor of a drive that stands alone, against plain formulations of its equations, with no number that is 1."""

from math import copysign, inf, sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_plant.drives.motor import Motor

MS = 1_000_000
INERTIA, FRICTION, RESOLUTION = 2e-3, 5e-3, 1e-4  # kg m^2, N m s/rad, rad: it runs out in 0.4 s
START_NS = 7 * MS

speeds = st.floats(-9000.0, 9000.0)
durations = st.integers(0, 900 * MS)


def motor(position: float = 0.0, velocity: float = 0.0) -> Motor:
    made = Motor(INERTIA, FRICTION, RESOLUTION, START_NS)
    made.position, made.velocity = position, velocity
    return made


@given(st.floats(-0.02, 0.02), speeds, durations)
def test_under_torque_it_is_a_mass_with_viscous_friction(torque: float, speed: float, duration_ns: int) -> None:
    made = motor(300.0, speed)
    made.push(torque, START_NS + duration_ns)
    angle, rate, dt = 300.0 * RESOLUTION, speed * RESOLUTION, duration_ns * 1e-9 / 1000
    for _ in range(1000):
        middle = rate + 0.5 * dt * (torque - FRICTION * rate) / INERTIA
        angle, rate = angle + dt * middle, rate + dt * (torque - FRICTION * middle) / INERTIA
    assert made.velocity == pytest.approx(rate / RESOLUTION, rel=1e-4, abs=0.1)
    assert made.position == pytest.approx(angle / RESOLUTION, rel=1e-4, abs=0.1)
    assert made.time_ns == START_NS + duration_ns


@given(speeds, speeds, st.floats(5e3, 1e5), durations)
def test_a_speed_is_approached_with_the_acceleration_and_kept(
    speed: float, target: float, acceleration: float, duration_ns: int
) -> None:
    made = motor(-70.0, speed)
    made.run(target, acceleration, START_NS + duration_ns)
    at, dt = -70.0, duration_ns * 1e-9 / 1000
    for _ in range(1000):
        change = max(-acceleration * dt, min(acceleration * dt, target - speed))
        at, speed = at + dt * (speed + 0.5 * change), speed + change
    assert made.velocity == pytest.approx(speed, abs=1e-6)
    assert made.position == pytest.approx(at, abs=acceleration * dt * dt + 1e-6)
    assert made.time_ns == START_NS + duration_ns


def test_a_speed_without_a_limit_of_acceleration_is_there_at_once() -> None:
    made = motor(5.0, -300.0)
    made.run(2000.0, inf, START_NS + 3 * MS)
    assert (made.position, made.velocity) == (pytest.approx(5.0 + 2000.0 * 3e-3), 2000.0)
    made.run(-40.0, inf, START_NS + 3 * MS)  # in no time at all
    assert (made.position, made.velocity) == (pytest.approx(11.0), -40.0)


@pytest.mark.parametrize("distance", [9000.0, -9000.0, 150.0, -150.0])
@pytest.mark.parametrize("acceleration", [3e4, 2e5, inf])
def test_a_position_is_approached_with_a_trapezoid_within_its_limits(distance: float, acceleration: float) -> None:
    fastest = 5000.0
    made, before, now_ns = motor(40.0), 0.0, START_NS
    while (made.position, made.velocity) != (40.0 + distance, 0.0):
        now_ns += MS
        made.go(40.0 + distance, fastest, acceleration, now_ns)
        assert abs(made.velocity) <= fastest
        assert abs(made.velocity - before) <= 2.0 * acceleration * 1e-3  # twice when it arrives within the step
        passed = (made.position - 40.0) * copysign(1.0, distance) - abs(distance)
        assert passed <= 1e-3 * fastest + 1e-9  # by a step of a millisecond at most
        assert now_ns < START_NS + 3000 * MS
        before = made.velocity
    size, ramp = abs(distance), 0.0 if acceleration == inf else fastest * fastest / acceleration
    ideal = size / fastest + fastest / acceleration if size > ramp else 2.0 * sqrt(size / acceleration)
    late = 1e-9 if acceleration == inf else 0.045
    assert ideal - 1e-3 <= (now_ns - START_NS) * 1e-9 <= ideal + late
    made.go(40.0 + distance, fastest, acceleration, now_ns + 50 * MS)
    assert (made.position, made.velocity, made.time_ns) == (40.0 + distance, 0.0, now_ns + 50 * MS)


def test_one_long_approach_is_many_of_a_millisecond() -> None:
    whole, pieces = motor(), motor()
    for end_ns in range(START_NS + MS, START_NS + 281 * MS, MS):
        pieces.go(4000.0, 20_000.0, 2e5, end_ns)
    whole.go(4000.0, 20_000.0, 2e5, START_NS + 280 * MS)  # it brakes
    assert (whole.position, whole.velocity, whole.time_ns) == (pieces.position, pieces.velocity, pieces.time_ns)
    assert 0.0 < whole.position < 4000.0


def test_a_position_at_an_instant_is_reached_evenly_then_and_kept() -> None:
    made, due_ns = motor(100.0, 999.0), START_NS + 8 * MS
    for part in (2, 3, 5):
        made.reach(180.0, due_ns, START_NS + part * MS)
        assert made.position == pytest.approx(100.0 + 10.0 * part)
        assert made.velocity == pytest.approx(10_000.0)
    made.reach(180.0, due_ns, START_NS + 11 * MS)
    assert (made.position, made.velocity, made.time_ns) == (180.0, 0.0, START_NS + 11 * MS)
    made.reach(70.0, due_ns, START_NS + 12 * MS)  # late: it is there
    assert (made.position, made.velocity) == (70.0, 0.0)
    made.reach(90.0, START_NS + 12 * MS, START_NS + 12 * MS)  # at once
    assert (made.position, made.velocity) == (90.0, 0.0)


def test_it_begins_at_rest_where_it_is_zero() -> None:
    made = Motor(INERTIA, FRICTION, RESOLUTION, START_NS)
    assert (made.position, made.velocity, made.time_ns) == (0.0, 0.0, START_NS)


def test_held_it_stands_still_and_no_time_passes_twice() -> None:
    made = motor(3.0, 500.0)
    made.push(0.01, START_NS - MS)
    assert (made.position, made.velocity, made.time_ns) == (3.0, 500.0, START_NS)
    made.hold(START_NS + MS)
    assert (made.position, made.velocity, made.time_ns) == (3.0, 0.0, START_NS + MS)
