"""How a CiA 402 drive is configured, or why it cannot be used: from its EDS and the rig's table [bus.cia402].

Rules. The drive has to offer cyclic synchronous torque (CST); it is refused where it does not, because in CSP and CSV
the drive's own loops decide the force, which no gate of ours then bounds. A required step whose object is missing,
read-only or out of range refuses the drive; an optional one is skipped, and the plan says so; an extra one is the
user's and counts as required. An object that is read-only but has the value already is no obstacle.

What a drive does on its own when it is disabled, in fault, or no longer hears its host (1029h, 6007h, 605Bh, 605Ch,
605Eh) is to let go, unless the rig says otherwise. A ramp of the drive's own is a force that nothing here bounds.

6071h is in thousandths of 6076h (mN m; mN on a linear axis), on many drives the motor's rated torque. It is read from
the drive at every start, or compared with what the rig states, and written only where the rig asks for it.

Two layouts. Shared: one RPDO carries the torques of all drives, each maps its own and dummies for the others; two more
carry the controlwords. Own: each drive has an RPDO of its own with controlword and torque.
"""

import math
from collections.abc import Sequence

from drivers.eds.reader import Eds, Entry, object_name
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import PDO_INVALID, mapping_entry
from drivers.families.cia402.config import Cia402Config
from drivers.families.cia402.drive_plan import FULL_SCALE, Axis, DrivePlan, Planned, Reason
from drivers.families.cia402.homing_mode import ACCELERATION, METHOD, SPEEDS
from drivers.families.cia402.inputs import DIGITAL_INPUTS, TPDO2_ID
from drivers.families.cia402.sdo import Step
from drivers.families.cia402.touch_probe import FUNCTION, PLACE, STATUS, SYNCS, TPDO3_ID

MASTER_ID = 127
DRIVE_HEARTBEAT_MS = 100
EMCY_ID = 0x680  # below SDO: at 080h four emergencies delay every TPDO, at 480h the host's SDO, which blocks its FIFO
DUMMY_INT16, DUMMY_UINT16 = 0x0003, 0x0006

_SYNC_PRODUCER = 1 << 30  # of 1005h
_NO_RTR = 1 << 30  # of a TPDO's COB-ID
_MODES = ("PP", "VL", "PV", "TQ", None, "HM", "IP", "CSP", "CSV", "CST", "CSTCA")  # bits of 6502h
_PDOS = 8  # looked at
_AT_SYNC, _AT_ONCE = 1, 255  # transmission types
_ORDERS = (0x1010, 0x1011)  # store, restore: what is read there is no value that was written


# Options that decide what force a drive applies on its own account; bus.cia402.write may state others.
_ENDINGS = (
    (0x1029, 1, 0, "a communication error ends operation"),
    (0x6007, 0, 2, "and disables the power stage"),
    (0x605B, 0, 0, "shutting down, it lets go at once"),
    (0x605C, 0, 0, "disabled, it lets go at once, without a ramp of its own"),
    (0x605E, 0, 0, "in fault, it lets go at once"),
)


def rated_torque(rated_force: float) -> tuple[int, int]:
    """Values of 6076h (mN or mN m) and 6072h (thousandths of it) for a rated force in N or N m."""
    unit = max(1, math.ceil(rated_force * 1e6 / FULL_SCALE))
    return unit, min(FULL_SCALE, math.floor(rated_force * 1e6 / unit))


def plan_drives(drives: Sequence[Eds], axes: Sequence[Axis], settings: Cia402Config) -> list[DrivePlan]:
    """Plans for all drives of a bus: with what all of them can share, where the settings leave that open."""
    counter = settings.sync_counter == "on"
    if settings.sync_counter == "auto":
        counter = all(_writable(eds, 0x1019) for eds in drives)

    def plans(shared: bool) -> list[DrivePlan]:
        return [_Planner(eds, axis, settings, shared, counter).plan for eds, axis in zip(drives, axes, strict=True)]

    if settings.rpdo != "auto":
        return plans(settings.rpdo == "shared")
    with_shared = plans(True)
    if all(plan.usable for plan in with_shared):
        return with_shared
    return plans(False)


def _is_identifier(index: int, subindex: int) -> bool:
    """Whether the object is a COB-ID."""
    return ((0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00) and subindex == 1) or index in (0x1005, 0x1014)


def _writable(eds: Eds, index: int, subindex: int = 0) -> bool:
    entry = eds.entry(index, subindex)
    return entry is not None and entry.writable


class _Planner:
    """Makes the plan of one drive."""

    def __init__(self, eds: Eds, axis: Axis, settings: Cia402Config, shared: bool, counter: bool) -> None:
        self._eds, self._axis, self._settings = eds, axis, settings
        self.plan = DrivePlan(eds.name, shared=shared, counter=counter)
        if self._is_no_drive():
            return
        self._check_device()
        self._communication()
        self._process_data()
        self._write(cia301.MODE, 0, cia301.TORQUE_MODE, "required", "cyclic synchronous torque")
        self._torque_unit()
        if axis.period_ns:
            self._cycle_period()
        self._sign()
        self._endings()
        for item in settings.write:
            self._write(*item.place, item.value, "extra", "bus.cia402.write")
        self._proofs()
        self.plan.warnings += eds.warnings[:20]

    # parts of the plan ------------------------------------------------------------------------------------------------

    def _is_no_drive(self) -> bool:
        """A device of another kind, of whose objects nothing more need be said."""
        profile, absent = self._eds.value(0x1000), []
        if profile is not None and profile & 0xFFFF != cia301.DEVICE_PROFILE:
            absent = [at for at in (cia301.CONTROLWORD, cia301.STATUSWORD) if self._eds.entry(at) is None]
        if len(absent) == 2:
            which = f"is {profile:#x}: device profile {(profile or 0) & 0xFFFF}, not 402"
            self._refuse(0x1000, 0, f"{which}, and 6040h and 6041h are not in the EDS: this is no drive by CiA 402")
        return len(absent) == 2

    def _check_device(self) -> None:
        """A CiA 402 drive that offers CST."""
        profile = self._eds.value(0x1000)
        if profile is not None and profile & 0xFFFF != cia301.DEVICE_PROFILE:
            self._refuse(0x1000, 0, f"is {profile:#x}: device profile {profile & 0xFFFF}, not 402")
        self._check(0x1000, cia301.DEVICE_PROFILE, 0xFFFF, "a drive by CiA 402")
        modes = self._eds.value(0x6502)
        if modes is not None:
            self.plan.offers = [name for bit, name in enumerate(_MODES) if name and modes >> bit & 1]
            if not modes & cia301.TORQUE_MODE_BIT:
                offered = ", ".join(self.plan.offers) or "none"
                self._refuse(
                    0x6502,
                    0,
                    f"is {modes:#x}: offers {offered}, not CST. In every other mode the drive's own loops or ramps "
                    "decide the force: limits, damped stop and emergency stop of this service would not bound it",
                )
        self._check(0x6502, cia301.TORQUE_MODE_BIT, cia301.TORQUE_MODE_BIT, "offers CST")

    def _communication(self) -> None:
        """SYNC, emergency messages, heartbeats."""
        eds, node = self._eds, self._axis.node_id
        sync = eds.value(0x1005)
        if sync is not None and sync & (_SYNC_PRODUCER | cia301.STANDARD_IDS) != cia301.SYNC_ID:
            self._write(0x1005, 0, cia301.SYNC_ID, "required", "the host produces SYNC, at 080h")
        if self.plan.counter:
            self._write(0x1006, 0, 0, "optional", "1019h may only be written while it is zero")
            self._write(0x1019, 0, cia301.SYNC_COUNTER_MAX, "required", "counter in SYNC")
        elif (eds.value(0x1019) or 0) > 0:
            self._write(0x1006, 0, 0, "optional", "1019h may only be written while it is zero")
            self._write(0x1019, 0, 0, "required", "no counter in SYNC")
        emcy = eds.value(0x1014)
        if self._write(0x1014, 0, EMCY_ID + node, "optional", "emergencies below SDO, where they delay no feedback"):
            self.plan.emcy_id = EMCY_ID + node
        elif emcy is not None and not emcy & PDO_INVALID:
            self.plan.emcy_id = emcy & cia301.STANDARD_IDS
        consumer = MASTER_ID << 16 | min(self._axis.master_ms, 0xFFFF)
        if not self._write(0x1016, 1, consumer, "optional", "the drive notices that the host fell silent"):
            self.plan.warnings.append(
                "1016h:01 cannot be set: the drive does not watch the host's heartbeat; what it does when the host "
                "falls silent has to come from its own settings"
            )
        self._write(0x1017, 0, DRIVE_HEARTBEAT_MS, "optional", "the host notices that the drive is gone")

    def _process_data(self) -> None:
        """PDOs: torque and controlword in, position and statusword out, nothing else."""
        axis = self._axis
        torque, word = self._entry(cia301.TORQUE, 16), self._entry(cia301.CONTROLWORD, 16)
        if self.plan.shared:
            torques = [torque if at == axis.number else mapping_entry(DUMMY_INT16, 0, 16) for at in range(axis.total)]
            words = [word if at == axis.number else mapping_entry(DUMMY_UINT16, 0, 16) for at in range(axis.total)]
            if axis.total > 1:
                for dummy in (DUMMY_INT16, DUMMY_UINT16):
                    if dummy not in self._eds.dummies:
                        self._refuse(dummy, 0, "is no dummy object of the drive: it can share no RPDO")
            self._pdo(0x1400, cia301.RPDO1_ID + axis.first_node, _AT_SYNC, torques)
            self._pdo(0x1401, cia301.RPDO2_ID + axis.first_node, _AT_ONCE, words)
            self._pdo(0x1402, cia301.RPDO3_ID + axis.first_node, _AT_SYNC, words)
        else:
            self._pdo(0x1400, cia301.RPDO1_ID + axis.node_id, _AT_SYNC, [word, torque])
        feedback = [self._entry(cia301.POSITION, 32), self._entry(cia301.STATUSWORD, 16)]
        if self._settings.watch_mode:
            feedback.append(self._entry(cia301.MODE_DISPLAY, 8))
            self.plan.watched = True
        can_id = cia301.TPDO1_ID + axis.node_id
        self._pdo(0x1800, can_id | (self._eds.value(0x1800, 1) or 0) & _NO_RTR, _AT_SYNC, feedback)
        if self._settings.inputs:
            can_id = TPDO2_ID + axis.node_id | (self._eds.value(0x1801, 1) or 0) & _NO_RTR
            self._pdo(0x1801, can_id, _AT_SYNC, [self._entry(DIGITAL_INPUTS, 32)])
            self.plan.inputs = True
        self._touch_probe()
        self._homing()
        used = {0x1800} | ({0x1801} if self.plan.inputs else set()) | ({0x1802} if self.plan.probe else set())
        for other in range(0x1800, 0x1800 + _PDOS):
            can_id = PDO_INVALID if other in used else self._eds.value(other, 1) or PDO_INVALID
            if not can_id & PDO_INVALID:
                self._write(other, 1, can_id | PDO_INVALID, "optional", "nothing else is to be sent cyclically")

    def _touch_probe(self) -> None:
        """60B8h to 60BAh, which find the encoder's index; no drive is refused for want of them."""
        eds = self._eds
        if not _writable(eds, FUNCTION):
            self.plan.no_probe = "60B8h is not in the EDS, or read-only: its drive has no touch probe"
            return
        told = [(STATUS, 16), (PLACE, 32)]
        entries = [eds.entry(index) for index, _ in told]
        if not all(entry is not None and entry.readable for entry in entries):
            self.plan.no_probe = "60B9h or 60BAh is not in the EDS: its drive's touch probe cannot be read"
            return
        mapped = all(entry is not None and entry.mappable for entry in entries)
        if not self._settings.touch_probe:
            return
        if not mapped or eds.entry(0x1802, 1) is None or not _writable(eds, 0x1A02):
            text = "60B9h and 60BAh cannot be mapped into TPDO 3: its drive is asked for them once the axis rests"
            self.plan.warnings.append(f"bus.cia402.touch_probe: {text}")
            return
        can_id = TPDO3_ID + self._axis.node_id | (eds.value(0x1802, 1) or 0) & _NO_RTR
        self._pdo(0x1802, can_id, SYNCS, [self._entry(index, bits) for index, bits in told])
        self.plan.probe = True

    def _homing(self) -> None:
        """What homing by the drive itself takes: it is bounded by 6072h and by the host's heartbeat, or not begun."""
        eds, modes = self._eds, self._eds.value(0x6502)
        needed = [(METHOD, 0), (SPEEDS, 1), (SPEEDS, 2), (ACCELERATION, 0), (cia301.TORQUE_MAX, 0), (cia301.MODE, 0)]
        for index, subindex in [*needed, (cia301.MODE_DISPLAY, 0), (0x1016, 1)]:
            entry = eds.entry(index, subindex)
            if entry is None or not entry.readable or not (entry.writable or index == cia301.MODE_DISPLAY):
                self.plan.no_homing = (
                    f"{object_name(index, subindex)} is not in the EDS, or cannot be written and read back"
                )
                return
        if modes is not None and not modes & cia301.HOMING_MODE_BIT:
            self.plan.no_homing = f"6502h is {modes:#x}: its drive offers no homing mode"

    def _torque_unit(self) -> None:
        """6076h and 6072h, and what 6071h may be."""
        axis, settings = self._axis, self._settings
        target = self._eds.entry(cia301.TORQUE)
        if target is not None:
            bounds = (FULL_SCALE, target.high, None if target.low is None else -target.low)
            self.plan.most = max(0, min(int(bound) for bound in bounds if bound is not None))
        unit = round(settings.rated_torque[axis.number] * 1000) if settings.rated_torque else None
        if unit == 0:
            text = f"counts in 0.001 N m (N); bus.cia402.rated_torque = {settings.rated_torque[axis.number]:g} is less"
            self._refuse(cia301.TORQUE_RATED, 0, text, "bus.cia402.rated_torque")
            unit = None
        if settings.write_rated_torque:
            if unit is None and axis.rated_force is not None:
                unit = rated_torque(axis.rated_force)[0]
            self._write(cia301.TORQUE_RATED, 0, unit or 1, "required", "bus.cia402.write_rated_torque")
        elif self._eds.entry(cia301.TORQUE_RATED) is not None:
            self._check(cia301.TORQUE_RATED, unit or 0, 0xFFFFFFFF if unit else 0, "the unit of 6071h")
        elif unit is None:
            text = "is not in the EDS: state bus.cia402.rated_torque, the unit of 6071h"
            self._refuse(cia301.TORQUE_RATED, 0, text, "bus.cia402.rated_torque")
        self.plan.unit = unit
        if unit is None or axis.rated_force is None:
            self._write(
                cia301.TORQUE_MAX, 0, 0, "optional", "limit in the drive", "left as it is: 6076h is not known yet"
            )
            return
        limit = math.floor(axis.rated_force * 1e6 / unit)
        if limit > FULL_SCALE:
            self._refuse(
                cia301.TORQUE, 0, f"can say 32.767 times 6076h; the rated force is {limit / 1000:.1f} times {unit} mN m"
            )
        elif limit > self.plan.most:
            text = f"allows {self.plan.most} thousandths of 6076h, {self.plan.most * unit * 1e-6:g} N (N m), at most"
            self._refuse(cia301.TORQUE, 0, f"{text}; the rated force is {axis.rated_force:g}: state no more than that")
        self.plan.limit = min(FULL_SCALE, limit)
        self._write(cia301.TORQUE_MAX, 0, self.plan.limit, "optional", "limit in the drive")

    def _cycle_period(self) -> None:
        """Period of SYNC and set-points, by which some drives interpolate."""
        period_ns = self._axis.period_ns
        self._write(0x1006, 0, period_ns // 1000, "optional", "the drive knows the period of SYNC")
        for exponent in range(-3, -10, -1):
            unit_ns = 10 ** (9 + exponent)
            if period_ns % unit_ns == 0 and period_ns // unit_ns <= 255:  # UNSIGNED8
                self._write(0x60C2, 1, period_ns // unit_ns, "optional", "period of the set-points")
                self._write(0x60C2, 2, exponent, "optional", "its power of ten, in seconds")
                return
        if self._eds.entry(0x60C2, 1) is not None:
            self.plan.warnings.append(f"60C2h cannot express a period of {period_ns} ns; left as it is")

    def _sign(self) -> None:
        """607Eh turns positions round, and with some makers torques: the rig states signs (axes.NAME.direction)."""
        if self._eds.entry(0x607E) is not None and not self._is_stated(0x607E, 0):
            self._check(0x607E, 0, 0xFF, "the drive turns no sign round")

    def _endings(self) -> None:
        """What a drive does by itself when it is disabled, in fault, or alone: it lets go, and moves nothing."""
        for index, subindex, value, why in _ENDINGS if self._settings.stop_options == "release" else ():
            if not self._is_stated(index, subindex):
                self._write(index, subindex, value, "optional", why)

    def _proofs(self) -> None:
        """What was written is read back at the end, the value that was written last: an answer to a write is no proof
        of it. Orders (1010h, 1011h) and what the file calls write-only are not read. The drive's own application comes
        last, as it is asked again after every fault.
        """
        written = {
            (planned.step.object_index, planned.step.subindex): planned.step
            for planned in self.plan.planned
            if planned.step.size and not planned.skipped and planned.step.object_index not in _ORDERS
        }
        if self._eds.entry(cia301.MODE_DISPLAY) is not None:
            written[cia301.MODE_DISPLAY, 0] = Step(cia301.MODE_DISPLAY, 0, cia301.TORQUE_MODE, 1, width=1)
        for (index, subindex), step in sorted(written.items()):
            entry = self._eds.entry(index, subindex)
            if entry is None or entry.access == "wo":
                continue
            mask = (1 << 8 * step.size) - 1
            if _is_identifier(index, subindex):
                mask &= PDO_INVALID | cia301.STANDARD_IDS  # the rest is flags of the drive's own
            proof = step._replace(size=0, value=step.value & mask, mask=mask, required=False, proof=True)
            self.plan.proofs.append(proof)

    def _is_stated(self, index: int, subindex: int) -> bool:
        return any(item.place == (index, subindex) for item in self._settings.write)

    # single steps -----------------------------------------------------------------------------------------------------

    def _entry(self, index: int, bits: int) -> int:
        """Mapping value of an object that has to be mappable."""
        entry = self._eds.entry(index)
        if entry is None:
            self._refuse(index, 0, self._absent(index, 0))
        elif not entry.mappable:
            self._refuse(index, 0, "cannot be mapped into a PDO (PDOMapping = 0)")
        elif 8 * entry.size != bits:
            self._refuse(index, 0, f"has {8 * entry.size} bits; CiA 402 gives it {bits}")
        return mapping_entry(index, 0, bits)

    def _pdo(self, communication: int, can_id: int, kind: int, entries: Sequence[int]) -> None:
        """CiA 301, 7.5.2.38: invalidate the PDO, map it, make it valid. A fixed mapping may be right as it is."""
        mapping = communication + 0x200
        why = f"{'R' if communication < 0x1800 else 'T'}PDO {(communication & 0xFF) + 1}"
        values = [len(entries), *entries]
        fixed = not _writable(self._eds, mapping)
        as_needed = [self._eds.value(mapping, at) for at in range(len(values))] == values
        if self._eds.entry(communication, 1) is None:
            self._refuse(communication, 1, self._absent(communication, 1))
            return
        if fixed and not as_needed:
            self._refuse(
                mapping,
                0,
                f"{'is read-only' if (mapping, 0) in self._eds.entries else 'is not in the EDS'}: "
                f"{why} cannot be mapped as needed",
            )
            return
        if not fixed:
            self._write(communication, 1, can_id | PDO_INVALID, "required", f"{why}: off while it is mapped")
        self._write(communication, 2, kind, "required", f"{why}: {'at once' if kind == _AT_ONCE else 'at SYNC'}")
        if not fixed:
            self._write(mapping, 0, 0, "required", f"{why}: mapping off")
            for place, entry in enumerate(entries, 1):
                self._write(mapping, place, entry, "required", f"{why}: {object_name(entry >> 16, entry >> 8 & 0xFF)}")
            self._write(mapping, 0, len(entries), "required", f"{why}: mapping on")
        self._write(communication, 1, can_id, "required", f"{why}: identifier")

    def _check(self, index: int, value: int, mask: int, why: str) -> None:
        """Read an object and compare; a mask of 0 reads only."""
        entry = self._eds.entry(index)
        if entry is None:
            self._refuse(index, 0, self._absent(index, 0))
        step = Step(index, 0, value, mask=mask, width=entry.size if entry and entry.size else 4)
        self.plan.planned.append(Planned(step, "required", why))

    def _write(self, index: int, subindex: int, value: int, need: str, why: str, skipped: str = "") -> bool:
        """Write an object; True where that is going to be done."""
        entry = self._eds.entry(index, subindex)
        obstacle = self._obstacle(entry, index, subindex, value) or skipped
        size = entry.size if entry is not None and entry.size else 4
        step = Step(index, subindex, value % (1 << 8 * size), size, required=need != "optional", width=size)
        has_it = entry is not None and not entry.writable and entry.value == value
        if obstacle and need != "optional" and not has_it:
            self._refuse(index, subindex, f"{obstacle}: {why}")
        self.plan.planned.append(Planned(step, need, why, "has this value already" if has_it else obstacle))
        return not obstacle

    def _obstacle(self, entry: Entry | None, index: int, subindex: int, value: int) -> str:
        """Why the file says that an object cannot be written with a value, or nothing."""
        if entry is None:
            return self._absent(index, subindex)
        if not entry.writable:
            return f"is {'constant' if entry.access == 'const' else 'read-only'}"
        if not entry.holds(value):
            return f"cannot hold {value} (data type {entry.data_type:04X}h)"
        if (entry.low is not None and value < entry.low) or (entry.high is not None and value > entry.high):
            return f"allows {entry.low} to {entry.high}, not {value}"
        return ""

    def _absent(self, index: int, subindex: int) -> str:
        broken = self._eds.broken.get((index, subindex))
        return f"is broken in the EDS ({broken})" if broken else "is not in the EDS"

    def _refuse(self, index: int, subindex: int, text: str, remedy: str = "") -> None:
        reason = Reason(object_name(index, subindex), text, remedy)
        if reason not in self.plan.reasons:
            self.plan.reasons.append(reason)
