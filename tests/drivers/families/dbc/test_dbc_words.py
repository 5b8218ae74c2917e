"""Frames in the words of a DBC file: messages of J1939 are found by their parameter group."""

from pathlib import Path

import pytest

from drivers.families.dbc.words import dbc_reader, group_of
from drivers.frame import EXTENDED, Frame
from drivers.protocols.dbc_codec import load_dbc

# Two messages, by the identifiers 18FEF2FEh (broadcast) and 18EAFFFEh (to everybody).
TEXT = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
    'BO_ 2566845182 Fuel: 8 A\n SG_ Rate : 0|16@1+ (0.05,0) [0|0] "l/h" A\n'
    'BO_ 2565537790 Request: 3 A\n SG_ Asked : 0|24@1+ (1,0) [0|0] "" A\n'
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_ "VFrameFormat" "{default}";\n'
)


def words(folder: Path, can_id: int, data: bytes, default: str = "J1939PG") -> str:
    (folder / "made.dbc").write_text(TEXT.format(default=default))
    return dbc_reader(load_dbc(folder / "made.dbc"))(Frame(can_id | EXTENDED, data))


@pytest.mark.parametrize(
    ("can_id", "group"), [(0x18FEF2FE, 0xFEF2), (0x0CFEF203, 0xFEF2), (0x18EAFFFE, 0xEA00), (0x19EA2103, 0x1EA00)]
)
def test_a_group_is_an_identifier_without_priority_source_and_destination(can_id: int, group: int) -> None:
    assert group_of(can_id) == group


def test_a_message_of_j1939_is_found_whoever_sends_it(tmp_path: Path) -> None:
    assert words(tmp_path, 0x18FEF2FE, bytes((10, 0, 0, 0, 0, 0, 0, 0))) == "Fuel: Rate 0.5 l/h"
    assert words(tmp_path, 0x0CFEF203, bytes((10, 0, 0, 0, 0, 0, 0, 0))) == "Fuel from 03h: Rate 0.5 l/h"
    assert words(tmp_path, 0x18EA2103, bytes((1, 0, 0))) == "Request from 03h: Asked 1"
    assert words(tmp_path, 0x18FEF303, bytes(8)) == ""


def test_other_files_name_what_has_the_very_identifier(tmp_path: Path) -> None:
    assert words(tmp_path, 0x0CFEF203, bytes(8), default="ExtendedCAN") == ""
