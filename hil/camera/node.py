"""The camera's node: an image in, frames of [sensors] out, one a quantity."""

from collections import Counter
from dataclasses import dataclass, field

from drivers.base import plugins
from drivers.base.guard import BadAnswerError, Guard
from drivers.frame import Frame
from drivers.sensors.hil_frame import HilSensorFrame
from hil.camera.clock import Exposures
from hil.camera.contract import CameraError, Features, Image, Pixels, Seen, grey
from hil.camera.encoders import Encoders
from hil.camera.kept_images import KeptImages
from hil.camera.readings import Interpreter
from hil.rig.camera import DETECTOR_KIND, DETECTORS, CameraConfig
from hil.rig.schema import RigConfig


def detector_of(camera: CameraConfig) -> Features:
    """The detector that [camera] names. Raises ValueError naming the key."""
    made = plugins.find(DETECTOR_KIND, camera.detector, camera.source)
    plugins.check_parameters(DETECTOR_KIND, camera.detector, made, camera.parameters, given=0)
    if camera.detector in DETECTORS:
        ours: Features = made(**camera.parameters)
        return ours
    found: Features = Guard(DETECTOR_KIND, camera.detector, made).call("it cannot be made", made, **camera.parameters)
    return found


def looked_at(detector: Features, pixels: Pixels, exposed_ns: int) -> Seen:
    """What a detector makes of an image. Raises BadAnswerError where it answers something else."""
    seen = detector.of(pixels, exposed_ns)
    if not isinstance(seen, Seen):
        raise BadAnswerError(f"answered {type(seen).__name__}, expected hil.Seen")
    return seen


@dataclass
class Counts:
    """images: new ones. seen: of these, with the quantity, by quantity."""

    images: int = 0
    seen: Counter[str] = field(default_factory=Counter)


class CameraNode:
    """interpreter: of what is seen. encoders: None where none are needed. images: where new ones are kept; None:
    nowhere.
    """

    def __init__(
        self,
        rig: RigConfig,
        detector: Features,
        interpreter: Interpreter,
        encoders: Encoders | None,
        images: KeptImages | None = None,
    ) -> None:
        assert rig.camera is not None
        self._camera, self._detector = rig.camera, detector
        self._guard = Guard(DETECTOR_KIND, rig.camera.detector, type(detector), CameraError)
        self._interpreter, self._encoders, self._images = interpreter, encoders, images
        self.exposures = Exposures(round(rig.camera.latency * 1e9))
        self.counts = Counts()
        sensors = {quantity: rig.sensors[name] for quantity, name in rig.camera.sends.items()}
        self._frames = {
            quantity: HilSensorFrame(sensor.can_id, fd=sensor.fd, scale=sensor.scale)
            for quantity, sensor in sensors.items()
        }

    def frames(self, image: Image) -> list[Frame]:
        """Of a new image, one frame a quantity, all with the number of the image among the new ones and the instant of
        its exposure. A quantity that it does not show is sent as not valid. None of an image that was there before.
        """
        looked = self.look(image)
        if looked and self._images is not None:
            self._images.keep(image.pixels, self.counts.images, looked[0])
        return self.told(*looked) if looked else []

    def look(self, image: Image) -> tuple[int, Seen] | None:
        """Instant of the exposure, ns, and what a new image shows; None for one that was there before."""
        exposed_ns = self.exposures.of(image)
        if exposed_ns is None:
            return None
        pixels = grey(image.pixels)
        return exposed_ns, self._guard.call("of(image, stamp)", looked_at, self._detector, pixels, exposed_ns)

    def told(self, exposed_ns: int, seen: Seen) -> list[Frame]:
        """The frames of an image that was looked at."""
        place = self._encoders.at(exposed_ns) if self._encoders else None
        position, speed = (place.position, place.speed) if place else (None, 0.0)
        found = self._interpreter.quantities(seen, position, speed)
        number = self.counts.images
        self.counts.images += 1
        self.counts.seen.update(quantity for quantity in found if quantity in self._frames)
        return [frame.encode(found.get(quantity), number, exposed_ns) for quantity, frame in self._frames.items()]
