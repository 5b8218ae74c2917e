"""Drives that a DBC file describes, as [bus.dbc] binds its signals."""

from drivers.families import Family, Sides
from drivers.families.dbc.config import DbcKeys

_FOLDER = "drivers.families.dbc"
FAMILY = Family(
    layouts={"dbc:FILE": Sides(f"{_FOLDER}.host:DbcHost", f"{_FOLDER}.device:DbcDevice")},
    keys=DbcKeys,
    cut=f"{_FOLDER}.segments:cut",
    problems=f"{_FOLDER}.admission:problems",
    reader=f"{_FOLDER}.words:reader",
    sketch=f"{_FOLDER}.sketch:sketch",
    order=2,
)
