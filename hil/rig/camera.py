"""[camera]: what `hil camera` makes of images, and which sensors' frames it sends."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from drivers.base.keys import REQUIRED, Table, key
from drivers.base.plugins import Kind, known, unknown
from drivers.sensors.config import SensorConfig

DETECTORS: dict[str, str] = {"pipette-and-cell": "hil.camera.detector:Detector"}
DETECTOR_KIND = Kind("detector", "detectors", "camera", "detector", "hil.detectors", DETECTORS, ("of",))

Quantity = Literal["tip_x", "tip_y", "tip_z", "tip_error", "cell_x", "cell_y", "cell_shift", "dimple", "bolus"]
UNITS: dict[str, str] = {"bolus": "1"}  # of all others: m


class CameraConfig(Table):
    """[camera]: a camera above pipette and cell; `hil camera` sends what it sees as frames of [sensors]."""

    sends: Annotated[dict[Quantity, str], Field(min_length=1)] = key(
        REQUIRED,
        "sensor of [sensors] by quantity. tip_x, tip_y: the tip in the coordinates of the axes; tip_z: its height over "
        "the plane in focus; tip_error: distance of the tip from where the calibration has it; cell_x, cell_y: middle "
        "of the cell; cell_shift: its way since it was first seen with the axes at rest; dimple: depth of its dent; "
        "bolus: 1 is a full one",
    )
    axes: Annotated[list[str], Field(min_length=2, max_length=2)] = key(
        ["x", "y"], "the two axes that move in the image"
    )
    pixel: float = key(REQUIRED, "length in front of the lens that a pixel shows, by its magnification", "m", ge=1e-9,
                       le=1e-3)  # fmt: skip
    latency: float = key(
        0.05, "from the middle of the exposure to the image's arrival at this computer, at the soonest", "s", ge=0, le=1
    )
    detector: str = key(
        "pipette-and-cell",
        f"what finds tip and cell: {', '.join(DETECTORS)}; or one of your own (hil.Features): its registered name, "
        "package.module:Class, or ./file.py:Class beside the rig file",
    )
    parameters: dict[str, Any] = key({}, "of that detector: what its class takes")
    source: str = key(
        "", "of a detector of your own: its file's text, or its package's digest; filled in when the rig is loaded"
    )
    full_bolus: float = key(5e-9, "area in the image of a bolus that counts as 1", "m^2", gt=0, le=1e-4)
    depth_per_blur: float = key(
        0.0, "height of the tip over the plane in focus per pixel of blur; 0: not known", "m", ge=0, le=1e-2
    )
    sharp: float = key(1.0, "blur of the tip in focus", "px", ge=0, le=20)
    calibration_age: float = key(43_200.0, "oldest calibration that is used", "s", gt=0, le=1e8)

    @model_validator(mode="after")
    def _consistent(self) -> "CameraConfig":
        if self.axes[0] == self.axes[1]:
            raise ValueError(f"axes = {self.axes}: an axis twice")
        if len(set(self.sends.values())) != len(self.sends):
            raise ValueError(f"sends = {self.sends}: a sensor twice")
        if "tip_z" in self.sends and not self.depth_per_blur:
            raise ValueError("sends.tip_z: it needs depth_per_blur")
        if not self.source and not known(DETECTOR_KIND, self.detector):  # with it: of a package not here
            raise ValueError(unknown(DETECTOR_KIND, self.detector))
        return self

    @property
    def needs_calibration(self) -> bool:
        """Something that it sends is told in the coordinates of the axes."""
        return any(quantity.startswith(("tip_", "cell_")) and quantity != "tip_z" for quantity in self.sends)

    def problems(self, axes: list[str], sensors: dict[str, SensorConfig]) -> list[str]:
        """Axes and sensors that the rig has not, or that measure something else."""
        found = [f"camera.axes: no axis '{axis}'; the axes are {', '.join(axes)}" for axis in self.axes
                 if axis not in axes]  # fmt: skip
        for quantity, name in self.sends.items():
            unit = UNITS.get(quantity, "m")
            if name not in sensors:
                there = ", ".join(sensors) or "none"
                found.append(f"camera.sends.{quantity} = '{name}': no such sensor; those of [sensors] are: {there}")
            elif sensors[name].kind != "hil":
                found.append(f"camera.sends.{quantity}: sensors.{name}.kind = '{sensors[name].kind}', expected 'hil'")
            elif sensors[name].unit != unit:
                found.append(
                    f"camera.sends.{quantity}: sensors.{name}.unit = '{sensors[name].unit}', expected '{unit}'"
                )
        return found
