"""A DBC file, an EDS file and a class of a user's, each of a force sensor; rigs with one of them."""

from pathlib import Path

from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS

DBC = """VERSION ""

NS_ :

BS_:

BU_: scale host

BO_ 1009 Reading: 7 scale
 SG_ Force : 7|24@0- (0.00001,0) [-80|80] "mN" host
 SG_ Count : 27|4@1+ (1,0) [0|15] "" host
 SG_ State : 40|8@1+ (1,0) [0|255] "" host

BO_ 1010 Other: 8 scale
 SG_ Pressure : 0|32@1- (1,0) [0|0] "Pa" host
SIG_VALTYPE_ 1010 Pressure : 1;
"""

USER = """import hil


class Scale(hil.SensorFrame):
    def __init__(self, counts=1e8):
        self.counts = counts

    def decode(self, data):
        if len(data) != 5:
            return None
        return hil.Measured(int.from_bytes(data[:4], "big", signed=True) / self.counts, data[4])

    def encode(self, value, sequence, stamp_ns):
        return round(value * self.counts).to_bytes(4, "big", signed=True) + bytes((sequence,))
"""

BYPRODUCT = ', unit="N", noise=5e-6, range=[-0.01, 0.01]'
KINDS = {
    "dbc": 'sensors.force={kind="dbc", file="force.dbc", can_id=0x3F1, signal="Force", counter="Count", '
    f'status="State", scale=1e-3{BYPRODUCT}}}',
    "cia404": f'sensors.force={{kind="cia404", file="force.eds", can_id=0x1E0, node=96, scale=1e-6{BYPRODUCT}}}',
    "own": f'sensors.force={{kind="./force.py:Scale", can_id=0x3F1, scale=1.0{BYPRODUCT}}}',
}
MEASURED = "plant.sensors=[{sensor='force', measures='cell_force', axis='z', lag=5e-4}]"


def eds(value: int = 0x6130, *, status: bool = True, counter: bool = True) -> str:
    """Of a CiA 404 device with one channel, whose TPDO 1 is sent by events as it comes from its maker."""
    types = {0x5130: (0x2, 8), 0x6130: (0x8, 32), 0x7130: (0x3, 16), 0x9130: (0x4, 32)}
    data_type, bits = types[value]
    mapped = [value << 16 | 1 << 8 | bits, *([0x6150 << 16 | 1 << 8 | 8] if status else [])]
    lines = ["[DeviceInfo]", "VendorName=maker", "ProductName=load cell", "BaudRate_1000=1"]

    def variable(section: str, name: str, kind: int, access: str, default: object, pdo: int = 0) -> None:
        lines.extend((f"[{section}]", f"ParameterName={name}", "ObjectType=7", f"DataType={kind:#x}"))
        lines.extend((f"AccessType={access}", f"DefaultValue={default}", f"PDOMapping={pdo}"))

    def record(index: str, members: int) -> None:
        lines.extend((f"[{index}]", f"ParameterName=object {index}", "ObjectType=9", f"SubNumber={members + 1}"))
        variable(f"{index}sub0", "entries", 0x5, "ro", members)

    variable("1000", "Device type", 0x7, "ro", "0x20194")
    variable("1001", "Error register", 0x5, "ro", 0)
    if counter:
        variable("1019", "Synchronous counter overflow value", 0x5, "rw", 0)
    record("1018", 1)
    variable("1018sub1", "Vendor", 0x7, "ro", 0)
    record("1800", 2)
    variable("1800sub1", "COB-ID", 0x7, "rw", "$NODEID+0x180")
    variable("1800sub2", "Transmission type", 0x5, "rw", 255)
    record("1A00", len(mapped))
    for place, one in enumerate(mapped, 1):
        variable(f"1A00sub{place}", f"mapped {place}", 0x7, "rw", f"{one:#x}")
    for index, kind in ((f"{value:04X}", data_type), ("6150", 0x5)):
        record(index, 1)
        variable(f"{index}sub1", "channel 1", kind, "ro", 0, pdo=1)
    return "\n".join(lines) + "\n"


def rig_with(kind: str, folder: Path, *overrides: str, device: str = "") -> RigConfig:
    """A copy of a shipped rig with the sensor, whose files are in the folder."""
    (folder / "force.dbc").write_text(DBC)
    (folder / "force.eds").write_text(device or eds())
    (folder / "force.py").write_text(USER)
    path = folder / "rig.toml"
    path.write_bytes((RIGS / "microscope-ideal.toml").read_bytes())
    protocol = ("bus.protocol=cia402",) if kind == "cia404" else ()
    return load_rig(path, (*protocol, KINDS[kind], MEASURED, *overrides))
