"""Images of an emulated rig, drawn from what is true there."""

import math
import time

from hil.camera.contract import CameraError, Image
from hil.camera.sources.pace import Pace
from hil.live.runtime_paths import files_of_rigs
from hil.rig.schema import RigConfig
from sim_plant.nodes.picture import Optics, picture
from sim_plant.scene_page import SceneReader

WIDTH, HEIGHT = 640, 480


def optics_of(rig: RigConfig) -> Optics:
    """The emulated camera: it goes with the pipette, which stands in the middle of the picture."""
    assert rig.camera is not None
    camera, dish = rig.camera, rig.plant.dish
    return Optics(
        WIDTH,
        HEIGHT,
        camera.pixel,
        focus=dish.top if dish else 0.0,
        blur=camera.sharp,
        depth=1.0 / camera.depth_per_blur if camera.depth_per_blur else 0.0,
        full=math.sqrt(camera.full_bolus / math.pi),
        seed=rig.plant.seed,
    )


class Drawn:
    """Raises CameraError where no stage of that name is emulated with --camera."""

    def __init__(self, rig: RigConfig) -> None:
        start = f"start hil emulate with --camera for {rig.name}"
        found = files_of_rigs("scene", rig.name)
        if not found:
            raise CameraError(f"--source drawn: no emulated stage of {rig.name} shows its scene; {start}")
        try:
            self._scenes = SceneReader(found[0])
        except (OSError, ValueError) as error:
            raise CameraError(f"{found[0]}: {error}; {start}") from None
        self._optics = optics_of(rig)
        self._number = self._shown_ns = 0
        self._pace = Pace()

    def read(self) -> Image | None:
        """The scene as it is, exposed when it was so; None where the stage is not emulated any more."""
        self._pace.wait()
        try:
            scene, exposed_ns = self._scenes.read()
        except ValueError:
            return None
        if exposed_ns == self._shown_ns:
            return None
        self._shown_ns = exposed_ns
        self._number += 1
        pixels = picture(self._optics, scene, self._number)
        return Image(pixels, self._number, exposed_ns, time.monotonic_ns())

    def close(self) -> None:
        """Let go of the scene."""
        self._scenes.close()
