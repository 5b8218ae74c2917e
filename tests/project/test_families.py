"""A family of drives is known to its folder, its emulated drive and its tests; whoever else names one stands here.

The table may only become shorter: an entry that is no longer needed fails, too.
"""

import ast
from pathlib import Path

from drivers.families import families
from tests.support.paths import ROOT

FOLDERS = set(families())
LAYOUTS = {name.partition(":")[0] for family in families().values() for name in family.layouts}
TEXTS = (FOLDERS | LAYOUTS) - {"stage"}  # which is a word, too
CANOPEN = "a tool for CANopen nodes, which knows their services"
KNOWN = {
    "hil/operate/bench/bus.py": CANOPEN,
    "hil/operate/bringup/drive_host.py": CANOPEN,
    "hil/operate/bringup/frame_log.py": CANOPEN,
    "hil/operate/bringup/survey.py": CANOPEN,
    "hil/operate/drive.py": CANOPEN,
    "hil/operate/drives.py": CANOPEN,
    "hil/studies/fault_campaign/canopen.py": "faults of CANopen services",
    "hil/studies/fault_campaign/injections.py": "faults of CANopen services",
    "hil/operate/bus.py": "reads frames by any DBC file",
    "hil/rig/provenance.py": "keeps the EDS files of a run",
    "sim_plant/config.py": "keys of [plant.drive], of all emulated drives in one table",
    "drivers/protocols/dbc_codec.py": "the name of a file format",
    "drivers/sensors/cia404.py": "a node of CANopen beside the drives, with their master's services",
    "drivers/outputs/canopen.py": "the CANopen master of one node",
    "drivers/outputs/config.py": "the name of a file format",
    "drivers/outputs/writers.py": "the name of a file format",
    "drivers/sensors/config.py": "the name of a file format",
    "drivers/sensors/readers.py": "the name of a file format",
    "hil/rig/outputs.py": "which drives have a master that starts a CiA 401 node",
    "hil/rig/sensors.py": "which drives send the SYNC that a CiA 404 node samples at",
    "sim_plant/nodes/cia404.py": "constants of CiA 301",
    "sim_plant/nodes/other_outputs.py": "constants of CiA 301",
    "sim_plant/nodes/outputs.py": "the name of a file format",
    "sim_plant/nodes/other_frames.py": "the name of a file format",
    "sim_plant/nodes/sensors.py": "the name of a file format",
}
EMULATED = ("sim_plant/drives/", "sim_plant/drive_double.py")


def named(source: str) -> set[str]:
    """Families that a source names: as a text, or in an import of their folder."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value.partition(":")[0]} & TEXTS
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("drivers.families"):
            found |= {f"{node.module}.{alias.name}".split(".")[2] for alias in node.names} & FOLDERS
    return found


def offenders() -> dict[str, set[str]]:
    """Files that name families other than their own, and which."""
    found = {}
    for path in (path for package in ("hil", "drivers", "sim_plant") for path in (ROOT / package).rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        family = families().get(Path(name).parts[2]) if name.startswith("drivers/families/") else None
        own = {Path(name).parts[2], *family.layouts} if family else set()
        if not name.startswith(EMULATED) and (others := named(path.read_text()) - own):
            found[name] = others
    return found


def test_an_import_and_a_text_name_a_family() -> None:
    source = "from drivers.families.cia402 import cia301\nx = 'dbc:file'\nfrom drivers.families import moteus"
    assert named(source) == {"cia402", "dbc", "moteus"}


def test_nobody_else_names_a_family() -> None:
    assert set(offenders()) == set(KNOWN)


STANDARDS = {"drivers.families.cia402.cia301"}  # numbers of public standards
WHAT_A_RIG_SAYS = {
    "drivers.families.stage.config",
    "drivers.families.cia402.config",
    "drivers.families.cia402.host.node_ids",
}
WHAT_A_RIG_SAYS |= {f"drivers.families.moteus.layout.{name}" for name in ("COUNTS_PER_TURN", "moteus_nodes")}
WHAT_A_RIG_SAYS |= {f"drivers.families.mit.layout.{name}" for name in ("CODES", "mit_drives")}
FOR_PEOPLE = {"drivers.families.cia402.services"}
SHARED = STANDARDS | WHAT_A_RIG_SAYS | FOR_PEOPLE


def test_an_emulated_drive_is_written_apart_from_the_layout_it_is_the_truth_for() -> None:
    """Neither a side of the layout nor its codec."""
    imports = set()
    sources = [path.read_text() for path in (ROOT / "sim_plant").rglob("*.py")]
    for source in (source for source in sources if "drivers.families." in source):
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("drivers.families."):
                imports |= {f"{node.module}.{alias.name}" for alias in node.names}
    assert len(imports) > 10
    assert {name for name in imports if name not in SHARED and name.rpartition(".")[0] not in SHARED} == set()
