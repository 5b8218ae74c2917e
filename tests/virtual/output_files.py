"""A DBC file and an EDS file, each of a node with valves; rigs with one of them, whose motion is told what to do."""

from pathlib import Path

from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.support import told_motion
from tests.support.paths import RIGS

DBC = """VERSION ""

NS_ :

BS_:

BU_: valves host

BO_ 992 Switches: 4 host
 SG_ Light : 3|1@1+ (1,0) [0|1] "" valves
 SG_ Valve : 14|2@0+ (1,0) [0|2] "" valves
 SG_ Count : 16|4@1+ (1,0) [0|15] "" valves
 SG_ Level : 24|8@1+ (0.5,0) [0|100] "%" valves
"""

KINDS = {
    "hil": "outputs.valve={can_id=0x3E0, bit=2, longest_s=0.05}",
    "dbc": 'outputs.valve={kind="dbc", file="valves.dbc", can_id=0x3E0, signal="Valve", counter="Count", bit=2, '
    "longest_s=0.05}",
    "cia401": 'outputs.valve={kind="cia401", file="valves.eds", node=90, can_id=0x25A, channel=11, bit=2, '
    "longest_s=0.05}",
    "cia404": 'outputs.valve={kind="cia404", file="valves.eds", node=90, can_id=0x25A, channel=11, bit=2, '
    "longest_s=0.05}",
}


def eds(profile: int = 401, *, timer: bool = True, without: str = "", access: str = "rw") -> str:
    """Of a device with two bytes of outputs. without: an object it lacks. access: to its error modes."""
    lines = ["[DeviceInfo]", "VendorName=maker", "ProductName=valve box", "BaudRate_1000=1"]

    def variable(section: str, name: str, kind: int, access: str, default: object, pdo: int = 0) -> None:
        lines.extend((f"[{section}]", f"ParameterName={name}", "ObjectType=7", f"DataType={kind:#x}"))
        lines.extend((f"AccessType={access}", f"DefaultValue={default}", f"PDOMapping={pdo}"))

    def record(index: str, members: int) -> bool:
        if index == without:
            return False
        lines.extend((f"[{index}]", f"ParameterName=object {index}", "ObjectType=9", f"SubNumber={members + 1}"))
        variable(f"{index}sub0", "entries", 0x5, "ro", members)
        return True

    variable("1000", "Device type", 0x7, "ro", f"{2 << 16 | profile:#x}")
    variable("1001", "Error register", 0x5, "ro", 0)
    variable("1014", "COB-ID EMCY", 0x7, "rw", "$NODEID+0x80")
    variable("1017", "Producer heartbeat time", 0x6, "rw", 0)
    variable("1019", "Synchronous counter overflow value", 0x5, "rw", 0)
    record("1016", 1)
    variable("1016sub1", "Consumer heartbeat time", 0x7, "rw", 0)
    record("1018", 1)
    variable("1018sub1", "Vendor", 0x7, "ro", 0)
    record("1400", 5 if timer else 2)
    variable("1400sub1", "COB-ID", 0x7, "rw", "$NODEID+0x200")
    variable("1400sub2", "Transmission type", 0x5, "rw", 1)
    if timer:
        variable("1400sub5", "Event timer", 0x6, "rw", 0)
    record("1600", 2)
    for place in (1, 2):
        variable(f"1600sub{place}", f"mapped {place}", 0x7, "rw", f"{0x6200 << 16 | place << 8 | 8:#x}")
    for index, name, default, pdo in (
        ("6200", "Write output", 0, 1), ("6202", "Polarity", 0, 0), ("6206", "Error mode", 0, 0),
        ("6207", "Error value", 255, 0),
    ):  # fmt: skip
        if record(index, 2):
            for place in (1, 2):
                variable(f"{index}sub{place}", f"{name} {place}", 0x5, access if pdo == 0 else "rw", default, pdo)
    return "\n".join(lines) + "\n"


def rig_with(kind: str, folder: Path, *overrides: str, device: str = "") -> RigConfig:
    """A copy of a shipped rig with a valve whose files are in the folder; what it does is told (told_motion.py)."""
    (folder / "valves.dbc").write_text(DBC)
    (folder / "valves.eds").write_text(device or eds(404 if kind == "cia404" else 401))
    path = folder / "rig.toml"
    path.write_bytes((RIGS / "microscope-ideal.toml").read_bytes())
    protocol = ("bus.protocol=cia402",) if kind.startswith("cia") else ()
    motion = f"motion.name={Path(told_motion.__file__)}:Told"
    return load_rig(path, (*protocol, "task.kind=hold", motion, KINDS[kind], *overrides))


def light_beside(kind: str, **changes: str) -> str:
    """A second output at bit 0, like the valve but for these words."""
    words = KINDS[kind].replace("outputs.valve", "outputs.light").replace("bit=2", "bit=0")
    for old, new in changes.items():
        words = words.replace(old, new)
    return words
