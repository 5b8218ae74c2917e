"""The host's side of a rig's frame layout, if it can carry what the rig asks of it."""

from pathlib import Path

from drivers.protocols import host_protocol
from drivers.protocols.base import DriveStatus, HostProtocol, LayoutError, tells_of
from drivers.protocols.finding import AxisFinder, AxisHomer, drive_homer, index_finder
from hil.rig.count_size import size_problems
from hil.rig.outputs import check_outputs, writers_of
from hil.rig.schema import RigConfig
from hil.rig.sensors import check_sensors, readers_of

LIMITS = DriveStatus.LIMIT_LOW | DriveStatus.LIMIT_HIGH
_INDEX, _DRIVE = 'home.by = "index"', 'home.by = "drive"'
HOMED_BY = {"switch": DriveStatus.HOME, "index": DriveStatus.HOMED, "drive": DriveStatus.HOMED}


def host_layout(rig: RigConfig, base_dir: Path) -> HostProtocol:
    """Raises LayoutError (a ValueError) or OSError for a layout that the rig cannot have, naming the key."""
    rated = [axis.rated_force for axis in rig.axes.values()]
    layout = fitted(rig, host_protocol(rig.bus, len(rig.axes), rated, base_dir, rig.period_ns, rig.mountings))
    readers_of(rig, base_dir, layout)
    writers_of(rig, base_dir, layout)
    return layout


def fitted(rig: RigConfig, layout: HostProtocol) -> HostProtocol:
    """The layout of a rig with the same drives and bus, for what this rig has beside them. Raises LayoutError."""
    finders, homers = index_finders(rig, layout), drive_homers(rig, layout)
    for name, finder in finders.items():
        if isinstance(finder, str):
            raise LayoutError(f'axes.{name}.home.by = "index": {finder}')
    for name, homer in homers.items():
        if problem := _homer_problem(rig, name, homer):
            raise LayoutError(f"axes.{name}.home.method{problem}")
    for key, axis, demanded in demands(rig):
        if rig.axis_names[axis] in (finders | homers) and key.endswith((_INDEX, _DRIVE)):
            continue
        if missing := demanded & ~tells_of(layout, axis):
            raise LayoutError(
                f"bus.protocol = {rig.bus.protocol!r}: its answers have no bit for {DriveStatus(missing).name}, which "
                f"{key} needs. Bind the axis' digital inputs (docs/bindings.md) or leave the key out"
            )
    if problems := size_problems(rig, layout):
        raise LayoutError("; ".join(problems))
    check_sensors(rig, layout)
    check_outputs(rig, layout)
    return layout


def index_finders(rig: RigConfig, layout: HostProtocol) -> dict[str, AxisFinder | str]:
    """Of the axes that home on the encoder's index: what their drives find it with, or why they cannot. An axis whose
    drive counts from the index by itself is not among them.
    """
    asked = [name for name, axis in rig.axes.items() if axis.home is not None and axis.home.by == "index"]
    found = {name: index_finder(layout, rig.axis_names.index(name)) for name in asked}
    return {name: finder for name, finder in found.items() if finder}


def drive_homers(rig: RigConfig, layout: HostProtocol) -> dict[str, AxisHomer | str]:
    """Of the axes whose drives home by themselves when they are told to: what tells them, or why they cannot."""
    asked = [name for name, axis in rig.axes.items() if axis.home is not None and axis.home.by_itself]
    return {name: drive_homer(layout, rig.axis_names.index(name)) for name in asked}


def _homer_problem(rig: RigConfig, name: str, homer: AxisHomer | str) -> str:
    """Why the drive of an axis cannot home as the rig says, behind the key; empty where it can."""
    if isinstance(homer, str):
        return f": {homer}"
    axis, methods = rig.axes[name], homer.homer.methods
    method = axis.home.method if axis.home is not None else None
    if method not in methods:
        return f" = {method}: allowed {methods[0]}" + (f" to {methods[-1]}" if len(methods) > 1 else "")
    brake = rig.drives.brake
    braked = brake if isinstance(brake, bool) else brake[rig.axis_names.index(name)]
    if homer.homer.lets_go and not braked and abs(axis.model.gravity) > axis.model.coulomb:
        return (
            f": its drive applies no torque for a moment before and behind its homing, and axes.{name}.model.gravity = "
            f"{axis.model.gravity:g} exceeds coulomb = {axis.model.coulomb:g}; expected drives.brake = true"
        )
    return ""


def demands(rig: RigConfig) -> list[tuple[str, int, int]]:
    """What the rig asks drives to tell beyond themselves: the key that asks, the axis, and DriveStatus bits."""
    found = []
    for number, (name, axis) in enumerate(rig.axes.items()):
        if axis.limits.switches:
            found.append((f"axes.{name}.limits.switches = true", number, int(LIMITS)))
        if axis.home is not None and axis.home.by in HOMED_BY:
            found.append((f'axes.{name}.home.by = "{axis.home.by}"', number, int(HOMED_BY[axis.home.by])))
        for bit in axis.must_tell:
            found.append((f'axes.{name}.must_tell = ["{bit}"]', number, int(DriveStatus[bit.upper()])))
    return found
