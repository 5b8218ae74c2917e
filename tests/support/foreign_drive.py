"""CiA 402 drives made from stated facts: EDS text, and a drive whose SDO server is the canopen package's LocalNode.

The drive configures itself by what is written to it: it sends and takes PDOs as its own objects 1400h, 1600h, 1800h and
1A00h say, so that a master that maps wrongly gets nothing sensible back.
"""

from collections.abc import Mapping, Sequence
from io import StringIO
from typing import Any, NamedTuple

import canopen

from drivers.families.cia402 import cia301
from drivers.frame import Frame

U8, U16, U32, I8, I16, I32, STRING = 0x5, 0x6, 0x7, 0x2, 0x3, 0x4, 0x9


class Fact(NamedTuple):
    """One object as its maker describes it."""

    data_type: int
    access: str = "rw"
    value: str = "0"
    mappable: bool = False


def _pdo(communication: int, default_id: str, entries: int = 4) -> dict[tuple[int, int], Fact]:
    mapping = communication + 0x200
    facts = {(communication, 0): Fact(U8, "ro", "2"), (communication, 1): Fact(U32, "rw", default_id)}
    facts[communication, 2] = Fact(U8, "rw", "255")
    facts[mapping, 0] = Fact(U8)
    return facts | {(mapping, place): Fact(U32) for place in range(1, entries + 1)}


CST_DRIVE: dict[tuple[int, int], Fact] = {  # 1006h, 1019h, 6072h, 60C2h and dummy mapping: missing; 1014h read-only
    (0x1000, 0): Fact(U32, "ro", "0x00020192"),
    (0x1001, 0): Fact(U8, "ro"),
    (0x1005, 0): Fact(U32, "rw", "0x80"),
    (0x1014, 0): Fact(U32, "ro", "$NODEID+0x80"),
    (0x1016, 0): Fact(U8, "ro", "1"),
    (0x1016, 1): Fact(U32),
    (0x1017, 0): Fact(U16),
    (0x1018, 0): Fact(U8, "ro", "1"),
    (0x1018, 1): Fact(U32, "ro", "0xFB"),
    **_pdo(0x1400, "$NODEID+0x200"),
    **_pdo(0x1800, "$NODEID+0x40000180"),
    **_pdo(0x1801, "$NODEID+0x40000280"),
    (0x6040, 0): Fact(U16, "rw", "0", True),
    (0x6041, 0): Fact(U16, "ro", "0", True),
    (0x6060, 0): Fact(I8, "rw", "1"),
    (0x6061, 0): Fact(I8, "ro", "1"),
    (0x6064, 0): Fact(I32, "ro", "0", True),
    (0x6071, 0): Fact(I16, "rw", "0", True),
    (0x6076, 0): Fact(U32, "rw", "0"),
    (0x6502, 0): Fact(U32, "ro", "0x225"),
}

FULL_DRIVE = CST_DRIVE | {  # a CST drive that has whatever the standards offer, in ranges and with options of its own
    (0x1006, 0): Fact(U32),
    (0x1014, 0): Fact(U32, "rw", "$NODEID+0x80"),
    (0x1015, 0): Fact(U16),
    (0x1018, 1): Fact(U32, "ro", "0x2E1"),
    (0x1019, 0): Fact(U8),
    (0x1029, 0): Fact(U8, "ro", "1"),
    (0x1029, 1): Fact(U8, "rw", "1"),
    **_pdo(0x1401, "$NODEID+0x80000300", 8),
    **_pdo(0x1402, "$NODEID+0x80000400", 8),
    (0x6007, 0): Fact(I16, "rw", "1"),
    (0x605A, 0): Fact(I16, "rw", "2"),
    (0x605B, 0): Fact(I16, "rw", "1"),
    (0x605C, 0): Fact(I16, "rw", "1"),
    (0x605E, 0): Fact(I16, "rw", "2"),
    (0x6072, 0): Fact(U16, "rw", "3000"),
    (0x607E, 0): Fact(U8),
    (0x60C2, 0): Fact(U8, "ro", "2"),
    (0x60C2, 1): Fact(U8, "rw", "10"),
    (0x60C2, 2): Fact(I8, "rw", "-3"),
    (0x6502, 0): Fact(U32, "ro", "0x3ED"),
}

MOTION_DRIVE = CST_DRIVE | {  # one that offers every mode of CiA 402-2 that is emulated, and has names in words
    (0x1003, 0): Fact(U8, "rw", "0"),
    **{(0x1003, place): Fact(U32, "ro") for place in range(1, 5)},
    (0x1008, 0): Fact(STRING, "const", "A servo drive with a name of more than seven bytes"),
    (0x2000, 0): Fact(STRING, "rw", "nothing yet"),
    (0x603F, 0): Fact(U16, "ro", "0", True),
    (0x6060, 0): Fact(I8, "rw", "0", True),
    (0x6061, 0): Fact(I8, "ro", "0", True),
    (0x606C, 0): Fact(I32, "ro", "0", True),
    (0x6077, 0): Fact(I16, "ro", "0", True),
    (0x607A, 0): Fact(I32, "rw", "0", True),
    (0x607C, 0): Fact(I32),
    (0x607D, 0): Fact(U8, "ro", "2"),
    (0x607D, 1): Fact(I32),
    (0x607D, 2): Fact(I32),
    (0x6081, 0): Fact(U32, "rw", "1000"),
    (0x6083, 0): Fact(U32, "rw", "10000"),
    (0x6098, 0): Fact(I8, "rw", "35"),
    (0x60FD, 0): Fact(U32, "ro", "0", True),
    (0x60FF, 0): Fact(I32, "rw", "0", True),
    (0x6502, 0): Fact(U32, "ro", "0x3AD"),
}


def eds_text(facts: Mapping[tuple[int, int], Fact], dummies: Sequence[int] = ()) -> str:
    """An EDS file that states these facts."""
    lines = ["[FileInfo]", "FileName=made.eds", "[DeviceInfo]", "VendorName=Maker", "ProductName=Made"]
    lines += ["BaudRate_500=1", "BaudRate_1000=1", "NrOfRXPDO=4", "NrOfTXPDO=4", "[DummyUsage]"]
    lines += [f"Dummy{kind:04X}={int(kind in dummies)}" for kind in range(1, 8)]
    lines += ["[MandatoryObjects]", "SupportedObjects=0", "[OptionalObjects]"]
    lines += ["SupportedObjects=0", "[ManufacturerObjects]", "SupportedObjects=0"]
    records = {index for index, subindex in facts if subindex}
    for index in sorted(records):
        subs = [subindex for at, subindex in facts if at == index]
        lines += [f"[{index:04X}]", f"ParameterName=object {index:04X}h", "ObjectType=0x9", f"SubNumber={len(subs)}"]
    for (index, subindex), fact in facts.items():
        name = f"{index:04X}sub{subindex:X}" if index in records else f"{index:04X}"
        lines += [f"[{name}]", f"ParameterName=value {index:04X}h {subindex}", "ObjectType=0x7"]
        lines += [f"DataType=0x{fact.data_type:04X}", f"AccessType={fact.access}", f"DefaultValue={fact.value}"]
        lines += [f"PDOMapping={int(fact.mappable)}"]
    return "\n".join(lines) + "\n"


class ForeignDrive:
    """A drive on the facts given. rated_torque: value of 6076h, mN m. torque: thousandths it applies now."""

    def __init__(
        self,
        facts: Mapping[tuple[int, int], Fact],
        node_id: int,
        rated_torque: int = 500,
        *,
        values: Mapping[int, int] | None = None,
        dummies: Sequence[int] = (),
    ) -> None:
        """values: of objects whose fact states none."""
        source = StringIO(eds_text(facts, dummies))
        source.name = "made.eds"  # type: ignore[misc]  # canopen tells the format by it
        self._sent: list[Frame] = []
        network: Any = canopen.Network()
        network.send_message = lambda can_id, data, remote=False: self._sent.append(Frame(can_id, bytes(data)))
        self.node: Any = canopen.LocalNode(node_id, canopen.import_od(source, node_id))
        self.node.associate_network(network)
        if (0x6076, 0) in facts:
            self.node.object_dictionary[0x6076].default = rated_torque
        for index, value in (values or {}).items():
            self.node.object_dictionary[index].default = value
        self._network = network
        self.node.add_write_callback(self._show_mode)
        self.node_id = node_id
        self.state = cia301.DriveState.SWITCH_ON_DISABLED
        self.operational = False
        self.torque = 0
        self.position = 1000 * node_id
        self._pending: dict[int, int] = {}

    def boot(self) -> list[Frame]:
        """Power comes (again): what was configured is lost."""
        self.node.data_store.clear()
        self.operational, self.state, self.torque = False, cia301.DriveState.SWITCH_ON_DISABLED, 0
        return [Frame(cia301.HEARTBEAT_ID + self.node_id, b"\0")]

    def on_frame(self, frame: Frame) -> list[Frame]:
        """What it answers."""
        self._sent.clear()
        if frame.can_id == cia301.NMT_ID and frame.data[1] in (0, self.node_id):
            if frame.data[0] == cia301.NmtCommand.RESET_COMMUNICATION:
                return self.boot()
            self.operational = frame.data[0] == cia301.NmtCommand.START
        elif frame.can_id == cia301.SDO_REQUEST_ID + self.node_id:
            self._network.notify(frame.can_id, bytearray(frame.data), 0.0)
        elif self.operational and frame.can_id == cia301.SYNC_ID:
            return self._on_sync()
        elif self.operational and frame.can_id == self._get(0x1400, 1):
            self._take(frame.data)
        return list(self._sent)

    def _show_mode(self, index: int, data: bytes, **_: Any) -> None:
        """6061h says the mode that is written."""
        if index == cia301.MODE and cia301.MODE_DISPLAY in self.node.object_dictionary:
            self.node.set_data(cia301.MODE_DISPLAY, 0, data)

    def _get(self, index: int, subindex: int = 0) -> int:
        return int.from_bytes(self.node.get_data(index, subindex), "little")

    def _take(self, data: bytes) -> None:
        at = 0
        for place in range(1, self._get(0x1600) + 1):
            entry = self._get(0x1600, place)
            size = (entry & 0xFF) // 8
            self._pending[entry >> 16] = int.from_bytes(data[at : at + size], "little", signed=entry >> 16 == 0x6071)
            at += size

    def _on_sync(self) -> list[Frame]:
        word = self._pending.get(0x6040, 0)
        states = cia301.DriveState
        below = {states.SWITCH_ON_DISABLED: 0x6, states.READY_TO_SWITCH_ON: 0x7, states.SWITCHED_ON: 0xF}
        above = [states.SWITCH_ON_DISABLED, states.READY_TO_SWITCH_ON, states.SWITCHED_ON, states.OPERATION_ENABLED]
        asked = {0x6: 1, 0x7: 2, 0xF: 3}.get(word & 0xF, 0)
        level = above.index(self.state)
        if asked > level and word & 0xF in (below[self.state], 0xF):
            asked = level + 1
        self.state = above[asked if asked <= level + 1 else level]
        enabled = self.state is states.OPERATION_ENABLED and self._get(cia301.MODE) == cia301.TORQUE_MODE
        self.torque = self._pending.get(0x6071, 0) if enabled else 0
        values = {0x6064: self.position, 0x6041: self.state.value[1]}
        data = b""
        for place in range(1, self._get(0x1A00) + 1):
            entry = self._get(0x1A00, place)
            data += values[entry >> 16].to_bytes((entry & 0xFF) // 8, "little")
        return [Frame(self._get(0x1800, 1) & 0x7FF, data)]
