"""Sensors of a dish: force on the tip, and what a camera sees, sampled at the host's frames from a real axis."""

import math
from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusConfig
from drivers.frame import Frame
from drivers.protocols import host_protocol
from drivers.protocols.base import Command
from drivers.sensors.base import Measured
from drivers.sensors.config import SensorConfig
from drivers.sensors.hil_frame import HilSensorFrame
from sim_plant.config import EmulatedSensorConfig, PlantConfig
from sim_plant.emulator import EmulatedStage
from sim_plant.nodes.sensor import SensorNode, silent, stuck, tapped
from sim_plant.nodes.sensor_frames import OwnFrame

MS = 1_000_000
AXES = ["x", "y", "z"]
RATED = [5.0, 5.0, 5.0]
MASS = 0.25
CAN_ID = 0x3F1
SCALE = {"N": 1e-10, "m": 1e-9, "1": 1e-6}
FADELESS = [{"force": 0.75e-3, "depth": 180e-6}]


class Bench:
    """A tip that a constant push drives into the first cell, and one sensor that the host's frames ask in every ms."""

    def __init__(self, entry: dict[str, Any], unit: str = "N", delay: float = 0.0, **dish: Any) -> None:
        named = {"sensor": "probe", "axis": "z", "noise": 0.0, "delay": delay} | entry
        plant = PlantConfig.model_validate(
            {
                "mass": [0.9, 0.6, MASS],
                "coulomb": [0.0, 0.0, 0.0],
                "viscous": [0.0, 0.0, 0.0],
                "quadratic": [0.0, 0.0, 0.0],
                "gravity": [0.0, 0.0, 0.0],
                "encoder_resolution": 1e-9,
                "dish": {"positions": [[0.0, 0.0], [2e-3, 0.0]], "top": -0.1e-3, "spread": False} | dish,
                "sensors": [named],
            }
        )
        bus = BusConfig()
        self.host = host_protocol(bus, len(AXES), RATED, Path())
        command = self.host.encode(Command(0, [0.0] * 3, 0, False))[0]
        config = SensorConfig(
            can_id=CAN_ID, unit=unit, scale=SCALE[unit], noise=0.0, stuck_ticks=0, range=[-0.01, 0.01]
        )
        measured, heard = EmulatedSensorConfig(**named), (0x7FF, command.can_id)
        self.node = SensorNode("probe", config, 0, measured, OwnFrame(config), heard, 1)
        self.stage = EmulatedStage(plant, bus, AXES, RATED, Path(), sensors=[self.node])
        assert self.stage.dish is not None
        self.dish = self.stage.dish
        self.decoder = HilSensorFrame(CAN_ID, fd=False, scale=SCALE[unit])
        self.tick = 0
        self.heard: list[tuple[int, Measured]] = []
        self.forces: list[float] = []

    def run(self, ticks: int, push: float = 0.0) -> "Bench":
        """push: N on z."""
        self.stage.push(2, push)
        for _ in range(ticks):
            self.tick += 1
            (frame,) = self.host.encode(Command(self.tick % 256, [0.0] * 3, 0, False))
            answers = self.stage.on_frame(frame._replace(timestamp_ns=self.tick * MS))
            self._take(answers)
            self.forces.append(self.dish.force)
            self._take(self.stage.advance(self.tick * MS + MS // 2))
        return self

    def _take(self, frames: list[Frame]) -> None:
        for frame in frames:
            if frame.can_id == CAN_ID:
                found = self.decoder.decode(frame._replace(timestamp_ns=self.stage.now_ns))
                assert isinstance(found, Measured)
                self.heard.append((self.stage.now_ns, found))

    @property
    def values(self) -> list[float]:
        return [found.value for _, found in self.heard]

    def hold(self) -> None:
        self.stage.jam(2, 100.0)


INWARDS = -5e-3  # N: 20 mm/s^2


def test_the_force_sensor_shows_the_cells_force_and_its_fall() -> None:
    bench = Bench({"measures": "tip_force"}).run(250, INWARDS)
    cell = bench.dish.cells[0]
    assert cell.pierced_ns is not None
    assert bench.values == pytest.approx(bench.forces, abs=1e-10)
    top = bench.values.index(max(bench.values))
    assert top == cell.pierced_ns // MS - 1
    assert bench.values[top] == pytest.approx(0.75e-3, rel=0.05)
    assert bench.values[top + 4] == pytest.approx(20e-6, rel=0.05), "what is left is the shaft's friction"


def test_a_sensor_on_the_pipette_feels_the_tools_mass_and_one_below_the_cell_does_not() -> None:
    free, loaded = (
        Bench({"measures": "tip_force", "tool_mass": mass}, top=-1.0).run(50, INWARDS) for mass in (0, 6e-5)
    )
    assert free.values == [0.0] * 50
    assert loaded.values[2:] == pytest.approx([6e-5 * 20e-3] * 48, abs=2e-10), (
        "pressed on while it gathers speed inwards"
    )


def test_a_sensor_with_a_decay_forgets_a_held_force() -> None:
    bench = Bench({"measures": "tip_force", "decay": 0.5}, layers=FADELESS).run(150, INWARDS)
    bench.hold()
    bench.run(2000)
    true = bench.forces[-1]
    assert true > 0.2e-3
    assert bench.values[650] / bench.values[150] == pytest.approx(math.exp(-1.0), rel=5e-3)
    assert abs(bench.values[-1]) < 0.02 * true


def test_a_camera_sends_a_frame_of_every_exposure_as_late_as_it_is() -> None:
    bench = Bench({"measures": "tip_error", "frame_s": 1.0 / 30.0}, "m", delay=0.01).run(1000)
    assert len(bench.heard) == 30
    ages = [at_ns - found.stamp_ns for at_ns, found in bench.heard]
    assert set(ages) == {10 * MS}, "stamped when it was exposed"
    gaps = {second[1].stamp_ns - first[1].stamp_ns for first, second in zip(bench.heard, bench.heard[1:], strict=False)}
    assert gaps == {33 * MS, 34 * MS}
    assert [found.sequence for _, found in bench.heard] == list(range(30))


def test_a_camera_may_be_later_than_its_next_exposure_and_than_half_a_turn_of_the_stamp() -> None:
    bench = Bench({"measures": "tip_error", "frame_s": 1.0 / 30.0}, "m", delay=0.05).run(1000)
    assert [at_ns // MS for at_ns, _ in bench.heard[:3]] == [51, 84, 117]
    assert [found.sequence for _, found in bench.heard] == list(range(29))
    turned = {found.stamp_ns - at_ns for at_ns, found in bench.heard}
    assert turned == {65_536_000 - 50 * MS}, "the host has to know of such a delay to tell the turn"


def test_a_camera_sees_a_cell_roll_and_a_bolus_grow() -> None:
    rolled = Bench({"measures": "cell_shift"}, "m", anomalies=["rolled"]).run(230, INWARDS)
    assert rolled.values[:100] == [0.0] * 100
    assert rolled.values[-1] == pytest.approx(rolled.dish.cells[0].moved, abs=1e-9)
    assert rolled.values[-1] > 12e-6
    injected = Bench({"measures": "bolus"}, "1").run(220, INWARDS)
    injected.hold()
    injected.dish.outputs(1, injected.stage.now_ns)
    injected.run(50)
    assert injected.values[-1] == pytest.approx(0.5, abs=0.01)
    injected.dish.outputs(0, injected.stage.now_ns)
    injected.run(50)
    assert injected.values[-1] == pytest.approx(0.5, abs=0.02)
    assert injected.values[219] == 0.0


def test_a_camera_sees_a_broken_tip_a_millimetre_higher() -> None:
    assert Bench({"measures": "tip_error"}, "m").run(5).values == [0.0] * 5
    assert Bench({"measures": "tip_error"}, "m", anomalies=["broken"]).run(5).values == pytest.approx([1e-3] * 5)


def test_a_dead_sensor_shows_one_value_or_none_from_a_depth_on_and_works_again_outside() -> None:
    words = ["sensor_dead"]
    seen = set()
    for seed in range(1, 4):
        bench = Bench({"measures": "tip_force"}, anomalies=words, seed=seed).run(200, INWARDS)
        fails_silent = bench.dish.cells[0].fails_silent
        seen.add(fails_silent)
        if fails_silent:
            assert len(bench.heard) < 200
        else:
            assert len(bench.heard) == 200
            assert len(set(bench.values[-20:])) == 1
            assert bench.forces[-1] != bench.values[-1]
        camera = Bench({"measures": "cell_shift"}, "m", anomalies=words, seed=seed).run(200, INWARDS)
        assert len(camera.heard) == 200, "the camera works"
        before = len(bench.heard)
        bench.run(700, -INWARDS)  # out again
        assert bench.stage.position[2] > -0.05e-3
        assert len(bench.heard) > before
        assert bench.values[-1] == 0.0
    assert seen == {True, False}


def test_a_frozen_camera_sends_nothing_while_the_force_goes_on() -> None:
    camera = Bench({"measures": "cell_shift"}, "m", anomalies=["camera_frozen"]).run(250, INWARDS)
    assert 0 < len(camera.heard) < 250
    force = Bench({"measures": "tip_force"}, anomalies=["camera_frozen"]).run(250, INWARDS)
    assert len(force.heard) == 250


def test_what_a_scenario_does_to_a_sensor_it_does_to_a_camera() -> None:
    bench = Bench({"measures": "tip_error", "frame_s": 0.01}, "m").run(100)
    undo = tapped([bench.node], silent)
    assert len(bench.run(100).heard) == 11
    undo()
    tapped([bench.node], stuck)
    bench.dish.is_broken = True
    assert bench.run(50).values[-1] == pytest.approx(1e-3)
    bench.dish.is_broken = False
    assert bench.run(50).values[-1] == pytest.approx(1e-3), "the one it had"


def test_a_tools_mass_belongs_to_a_force_sensor() -> None:
    with pytest.raises(ValueError, match="of measures = 'tip_force' alone, not 'position'"):
        EmulatedSensorConfig(sensor="probe", measures="position", axis="z", tool_mass=1e-3)
