"""What `hil new` writes for drives of the MIT kind."""

from collections.abc import Sequence

from drivers.families import Sketched, SketchedAxis

_CODES = 65535  # of a position
_REACH = 12.5  # rad, P_MAX of most such drives
_ROOM = 1.1  # of the travel, that positions are to reach


def sketch(name: str, axes: Sequence[SketchedAxis], watchdog_s: float) -> Sketched:
    """Damiao motors numbered from 1, and what each makes of its torque by the travel of a turn. Counts as fine as asked
    for, or as the travel allows.
    """
    encoders = [max(axis.encoder, float(f"{_ROOM * axis.travel / _CODES:.3g}")) for axis in axes]
    gears = [float(f"{2.0 * _REACH / _CODES / encoder:.6g}") for encoder in encoders]
    torque = [float(f"{1.2 * axis.force / gear:.3g}") for axis, gear in zip(axes, gears, strict=True)]
    return Sketched(
        "[bus.mit]\n"
        'kind = "damiao"            # or cubemars, robstride\n'
        f"nodes = {[*range(1, len(axes) + 1)]}  # CAN_ID of each\n"
        f"position = {_REACH}            # P_MAX as the drives are set, rad\n"
        f"torque = {torque}  # T_MAX as each drive is set, N m\n"
        f"# Set the timeout of each drive to {watchdog_s:g} s: no frame carries it.\n",
        [f"gear = {gear!r}  # rad of the output shaft per m (rad) of the axis" for gear in gears],
        encoders=encoders,
    )
