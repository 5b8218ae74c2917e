"""A sensor's frames by a class of the user's: called in a limited time, and trusted with nothing."""

from abc import ABC, abstractmethod
from typing import Any

from drivers.base import plugins
from drivers.base.guard import BadAnswerError, Guard
from drivers.frame import FD, Frame
from drivers.protocols.base import LayoutError, Reject
from drivers.sensors.base import Measured
from drivers.sensors.config import SensorConfig, sensor_kind

_FAR = 1e12  # most that a value may be


class SensorFrame(ABC):
    """The frames of a sensor of your own: `kind` of [sensors.NAME], an object for each.

        class Scale(hil.SensorFrame):
            def __init__(self, counts=1e6):
                self.counts = counts

            def decode(self, data):
                return hil.Measured(int.from_bytes(data[:4], "big", signed=True) / self.counts, data[4])

            def encode(self, value, sequence, stamp_ns):
                return round(value * self.counts).to_bytes(4, "big", signed=True) + bytes((sequence,))

    Parameters are those of [sensors.NAME.parameters]. `encode` is for the emulated sensor alone: without it nothing can
    be emulated.
    """

    def __init__(self, **parameters: Any) -> None:  # noqa: B027
        """Every sensor's is made like this, once for each control cycle."""

    @abstractmethod
    def decode(self, data: bytes) -> Measured | None:
        """The measurement in the bytes of a frame, in the unit over `scale`; None where they are none. Called for each
        frame of `can_id`; it must return well within the period.
        """

    def encode(self, value: float, sequence: int, stamp_ns: int) -> bytes:
        """What a sensor sends. value: in the unit over `scale`. sequence: 0 to 255. stamp_ns: of its clock."""
        raise NotImplementedError("it has no encode, and cannot be emulated")


class UserSensorFrame:
    """A SensorReader around one. Raises LayoutError naming key, file and line."""

    def __init__(self, name: str, config: SensorConfig) -> None:
        kind = sensor_kind(name)
        try:
            made = plugins.find(kind, config.kind, config.source)
            plugins.check_parameters(kind, config.kind, made, config.parameters, given=0)
        except ValueError as error:
            raise LayoutError(str(error)) from None
        self._guard = Guard(kind, config.kind, made, LayoutError)
        self._side = self._guard.call("it cannot be made", made, **config.parameters)
        self.can_ids = (config.can_id,)
        self.problem = ""
        self._fd, self._scale = config.fd, config.scale

    def decode(self, frame: Frame) -> Measured | Reject:
        """See SensorReader: what is no measurement has an invalid value, and `problem` says the line."""
        if bool(frame.flags & FD) != self._fd:
            return Reject.WRONG_FORMAT
        try:
            found = self._guard.call("decode", self._side.decode, frame.data)
            return Reject.INVALID_VALUE if found is None else self._checked(found)
        except LayoutError as error:
            self.problem = str(error)
        except BadAnswerError as error:
            self.problem = self._guard.told("decode", error)
        return Reject.INVALID_VALUE

    def _checked(self, found: Any) -> Measured:
        if not isinstance(found, Measured):
            raise BadAnswerError(f"returned {found!r:.60}, expected hil.Measured or None")
        value, sequence, stamp_ns, valid = found
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _FAR:
            raise BadAnswerError(f"value = {value!r:.40}, expected a number of at most {_FAR:g}")
        if type(sequence) is not int or not -1 <= sequence <= 255:
            raise BadAnswerError(f"sequence = {sequence!r:.40}, expected 0 to 255, or -1")
        if stamp_ns is not None and (type(stamp_ns) is not int or not abs(stamp_ns) < 2**62):
            raise BadAnswerError(f"stamp_ns = {stamp_ns!r:.40}, expected ns, or None")
        return Measured(float(value) * self._scale, sequence, stamp_ns, bool(valid))

    def encode(self, value: float, sequence: int, stamp_ns: int) -> bytes:
        """What an emulated sensor sends; value in the sensor's unit. Raises LayoutError, which ends a run."""
        data = self._guard.call("encode", self._side.encode, value / self._scale, sequence, stamp_ns)
        if not isinstance(data, bytes) or len(data) > (64 if self._fd else 8):
            raise LayoutError(self._guard.told("encode", f"returned {data!r:.60}, expected the bytes of a frame"))
        return data

    def service(self) -> Frame | None:
        """It needs nothing."""
        return None
