"""`hil rigs`: the rig files that come with hil, and the rigs whose sidecar runs for this user."""

from typing import Any

from rich.table import Table

from hil.cli.console import plain_console
from hil.cli.options import JsonTarget
from hil.cli.output import write_json
from hil.live.runtime_paths import known_sidecars
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.rig.shipped import names, shipped


def rigs(json_target: JsonTarget = "") -> None:
    """List the rig files that come with hil, and the rigs that run here. Each name can stand for RIG."""
    folder = shipped("rigs")
    found = {name: _described(load_rig(folder / f"{name}.toml")) for name in names("rigs")}
    running = [{"name": known.rig, "endpoint": known.endpoint} for known in known_sidecars()]
    if json_target:
        write_json({"shipped": found, "running": running}, json_target)
        return
    table = Table("rig", "axes", "rate", "drives", "law", box=None, padding=(0, 2, 0, 0))
    for name, rig in found.items():
        table.add_row(name, " ".join(rig["axes"]), f"{rig['rate_hz']:g} Hz", rig["drives"], rig["law"])
    plain_console().print(table)
    print(f"Their files: {folder}. For your own stage: hil new my-stage.toml")
    for known in running:
        print(f"running: {known['name']} at {known['endpoint']}")
    if not running:
        print("No rig runs for this user.")


def _described(rig: RigConfig) -> dict[str, Any]:
    return {"axes": [*rig.axes], "rate_hz": rig.rate_hz, "drives": rig.bus.protocol, "law": rig.law.name}
