"""Cells injected by what images show: each exposure is drawn, looked at by the detector, and sent as the camera's node
sends it. In virtual time, where drawing may take as long as it likes.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.camera.calibration import stated
from hil.camera.contract import Spot
from hil.camera.detector import Detector
from hil.camera.readings import Interpreter
from hil.camera.sources.drawn import HEIGHT, WIDTH, optics_of
from hil.control.motion.injection.verdict import Verdict
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.inject import batch
from hil.studies.inject.batch import Batch, inject
from hil.studies.inject.equipment import middle, words
from hil.virtual.lockstep import LockstepRun
from sim_plant.nodes.picture import picture
from sim_plant.nodes.sensor import SensorNode, Stage
from sim_plant.nodes.sensor_frames import Sampled
from sim_plant.scene_page import scene_of
from tests.support.paths import RIGS

RIG = RIGS / "microscope.toml"
QUANTITIES = {"tip": "tip_error", "shift": "cell_shift", "bolus": "bolus"}
CAMERA = "camera={pixel=2.5e-6, sends={tip_error='tip', cell_shift='shift', bolus='bolus'}}"


def cells_rig(*anomalies: str) -> RigConfig:
    plain = load_rig(RIG)
    x, y = middle(plain)
    places = [(x + 1e-3 * number, y) for number in range(len(anomalies))]
    found = words(plain, places, 1, 0.0, anomalies, fd=True, how={"settle_s": 0.15})
    return load_rig(RIG, (*found, CAMERA))


class Seeing:
    """Puts what is seen of the drawn scene in place of the truth. images: that were looked at."""

    def __init__(self, run: LockstepRun) -> None:
        rig = run.rig
        assert rig.camera is not None
        self._run, self._optics = run, optics_of(rig)
        self._detector = Detector(**rig.camera.parameters)
        self._interpreter = Interpreter(rig.camera, stated(rig.camera, Spot((WIDTH - 1) / 2, (HEIGHT - 1) / 2)))
        self._axes = tuple(rig.axis_names.index(name) for name in "xyz")
        self._exposed_ns, self._found = -1, dict[str, float]()
        self.images = 0
        for node in run.stage.sensors:
            if node.name in QUANTITIES:
                self._take(node, QUANTITIES[node.name])

    def _take(self, node: SensorNode, quantity: str) -> None:
        def measured(stage: Stage) -> float:
            return self.look().get(quantity, 0.0)

        def shown(sampled: Sampled) -> Sampled:
            return sampled if quantity in self._found else replace(sampled, status=1)

        node._measured = measured  # type: ignore[method-assign]
        node.taps.append(shown)

    def look(self) -> dict[str, float]:
        """What the image of this instant shows."""
        stage = self._run.stage
        if stage.now_ns != self._exposed_ns:
            self._exposed_ns = stage.now_ns
            x, y, z = self._axes
            image = picture(self._optics, scene_of(stage, (x, y, z)), self.images)
            seen = self._detector.of(image.astype(np.float64), stage.now_ns)
            places, speeds, _ = stage.tips
            speed = math.hypot(speeds[x], speeds[y])
            self._found = self._interpreter.quantities(seen, (places[x], places[y]), speed)
            self.images += 1
        return self._found


def injected(monkeypatch: pytest.MonkeyPatch, *anomalies: str) -> tuple[Batch, Seeing]:
    eyes: list[Seeing] = []

    class Seen(LockstepRun):
        def __init__(self, *arguments: object, **more: object) -> None:
            super().__init__(*arguments, **more)  # type: ignore[arg-type]
            eyes.append(Seeing(self))

    monkeypatch.setattr(batch, "LockstepRun", Seen)
    return inject(cells_rig(*anomalies), RIGS), eyes[0]


@pytest.mark.slow
def test_a_batch_by_image_features_has_the_verdicts_that_its_truth_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    done, eyes = injected(monkeypatch, "", "clogged", "rolled", "no_cell")
    assert [cell.result.verdict for cell in done.cells] == [
        Verdict.OK, Verdict.CLOGGED, Verdict.ROLLED, Verdict.NO_CELL
    ], [(cell.result.verdict.name, cell.result.evidence) for cell in done.cells]  # fmt: skip
    assert sum(cell.wrong_pulses for cell in done.cells) == 0
    assert eyes.images > 60
