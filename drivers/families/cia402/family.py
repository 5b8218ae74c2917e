"""CiA 402 drives on CANopen, as their EDS describe them."""

from drivers.families import Family, Sides
from drivers.families.cia402.config import Cia402Keys

_FOLDER = "drivers.families.cia402"
FAMILY = Family(
    layouts={"cia402": Sides(f"{_FOLDER}.host:Cia402Host", f"{_FOLDER}.listener:Cia402Listener")},
    keys=Cia402Keys,
    cut=f"{_FOLDER}.host:cut",
    canopen=True,
    reader=f"{_FOLDER}.services:reader",
)
