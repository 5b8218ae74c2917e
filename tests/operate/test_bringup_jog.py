"""The jog at bring-up has torque while a key is held, and never else."""

from pathlib import Path

import pytest

from drivers.protocols.base import DriveStatus
from hil.operate.bringup.jog import NEGATIVE, POSITIVE, UNLATCH_S, Jog, Unlatch, jog_settings
from hil.rig.file import load_rig
from tests.support.bringup_bench import KINDS, BringupBench, Keys, bench_of
from tests.support.paths import RIGS


class Jogged:
    """A bench after a survey, with a jog of axis x under way and all that it sent since."""

    def __init__(self, kind: str, folder: Path, **plant: object) -> None:
        self.bench = bench_of(kind, folder, **plant)
        assert self.bench.survey().ready
        self.keys = Keys(self.bench)
        self.jog = Jog(self.bench.host, jog_settings(self.bench.rig, "x", None, None, None), self.keys)
        self.torques: list[float] = []

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.bench.tick(self.jog)
            self.torques.append(self.bench.stage.applied_force[0])


@pytest.fixture(params=KINDS)
def jogged(request: pytest.FixtureRequest, tmp_path: Path) -> Jogged:
    return Jogged(request.param, tmp_path)


@pytest.mark.parametrize(("key", "sign"), [(POSITIVE, 1), (NEGATIVE, -1)])
def test_an_axis_moves_while_its_key_is_held_and_the_others_do_not(jogged: Jogged, key: str, sign: int) -> None:
    jogged.tick(50)
    assert set(jogged.torques) == {0.0}
    assert not jogged.bench.host.any_enabled
    jogged.keys.held = key
    while not jogged.jog.done and jogged.jog.farthest < 1e-3:
        jogged.tick()
    assert sign * jogged.jog.moved > 0.9e-3
    assert jogged.bench.stage.applied_force[1] == 0.0
    force = jogged.jog.settings.force
    assert max(abs(torque) for torque in jogged.torques) <= force * (1 + 2e-3)  # one step of what the layout carries
    assert jogged.jog.was_enabled or "vesc" in jogged.bench.rig.bus.protocol


@pytest.mark.parametrize("kind", [*KINDS, "microscope", "paper-dbc", "damiao"])
def test_a_watchdog_that_ran_out_while_the_report_was_shown_holds_up_no_jog(kind: str, tmp_path: Path) -> None:
    bench = bench_of(kind, tmp_path) if kind in KINDS else BringupBench(load_rig(RIGS / f"{kind}.toml"), RIGS)
    assert bench.survey().ready
    bench.now_ns += 300_000_000
    bench.heard += [frame._replace(timestamp_ns=bench.now_ns) for frame in bench.stage.advance(bench.now_ns)]
    axis = bench.rig.axes["x"]
    force = axis.push.force if axis.push else 4 * axis.model.coulomb
    bench.run(Unlatch(bench.host, 0))
    assert set(bench.stage.applied_force) == {0.0}
    keys = Keys(bench)
    keys.held = POSITIVE
    jog = Jog(bench.host, jog_settings(bench.rig, "x", force, None, None), keys)
    while not jog.done and jog.farthest < 1e-3:
        bench.tick(jog)
    assert (jog.ended, jog.was_enabled) == ("", True)


def test_a_fault_that_stays_is_not_waited_for(tmp_path: Path) -> None:
    jogged = Jogged("cia402", tmp_path)
    jogged.bench.stage.drives[0].broken = True
    jogged.bench.stage.drives[0].fail()
    begun_ns = jogged.bench.now_ns
    jogged.bench.run(Unlatch(jogged.bench.host, 0))
    assert jogged.bench.now_ns - begun_ns <= (UNLATCH_S + 0.01) * 1e9
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    assert jogged.jog.ended
    assert set(jogged.torques) == {0.0}


def test_torque_is_zero_within_a_period_of_the_time_out(jogged: Jogged) -> None:
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    assert abs(jogged.torques[-1]) > 0.0
    jogged.keys.held = ""
    pressed_ns = jogged.jog._pressed_ns
    timeout_ns = round(jogged.jog.settings.key_timeout_s * 1e9)
    while jogged.jog.held:
        jogged.tick()
    assert jogged.bench.now_ns - pressed_ns <= timeout_ns + jogged.bench.rig.period_ns
    assert jogged.jog.force == 0.0
    assert jogged.torques[-1] == 0.0
    jogged.tick(40)
    assert DriveStatus.ENABLED not in jogged.bench.host.status(0)


def test_any_other_key_ends_it_at_once(jogged: Jogged) -> None:
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    jogged.keys.held = " "
    jogged.tick(40)
    assert jogged.jog.ended == "another key"
    assert jogged.torques[-1] == 0.0


def test_it_never_goes_beyond_speed_and_distance(jogged: Jogged) -> None:
    jogged.keys.held = POSITIVE
    fastest = 0.0
    for _ in range(10_000):
        if jogged.jog.done:
            break
        jogged.tick()
        fastest = max(fastest, abs(float(jogged.bench.stage.velocity[0])))
    settings = jogged.jog.settings
    assert "it has moved" in jogged.jog.ended
    assert settings.distance < jogged.jog.moved < 1.1 * settings.distance
    assert fastest < 2.0 * settings.speed
    assert jogged.torques[-1] == 0.0


def test_a_position_that_stays_away_ends_it(jogged: Jogged) -> None:
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    jogged.bench.change = lambda frame: []
    ticks = 0
    while not jogged.jog.done:
        jogged.tick()
        ticks += 1
    assert "no position from the drive" in jogged.jog.ended
    assert ticks * jogged.bench.rig.period_ns < 0.1e9
    assert jogged.torques[-1] == 0.0


def test_a_drive_that_latches_a_fault_ends_it(tmp_path: Path) -> None:
    jogged = Jogged("cia402", tmp_path)
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    jogged.bench.stage.drives[0].fail()
    jogged.tick(5)
    assert "fault" in jogged.jog.ended or "emergency" in jogged.jog.ended
    assert jogged.torques[-1] == 0.0


def test_a_drive_that_never_enables_is_told_of(tmp_path: Path) -> None:
    jogged = Jogged("cia402", tmp_path, enable_delay_s=1.0)
    jogged.keys.held = POSITIVE
    jogged.tick(300)
    assert not jogged.jog.was_enabled
    assert set(jogged.torques) == {0.0}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("z", None, None, None), "the rig has x, y"),
        (("x", 50.0, None, None), "at most axes.x.limits.force"),
        (("x", 0.0, None, None), "above 0"),
        (("x", None, 4.0, None), "at most half of axes.x.limits.speed"),
        (("x", None, None, 9.0), "at most the travel"),
    ],
)
def test_what_the_rig_does_not_bear_is_refused_before_a_bus_is_opened(
    asked: tuple[str, float | None, float | None, float | None], said: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=said):
        jog_settings(bench_of("odrive", tmp_path).rig, *asked)


def test_a_rig_without_a_push_needs_a_force() -> None:
    with pytest.raises(ValueError, match=r"^--force: state the greatest force, .* at most 5; .* A first try: 3\.4$"):
        jog_settings(load_rig(RIGS / "paper.toml"), "x", None, None, None)
