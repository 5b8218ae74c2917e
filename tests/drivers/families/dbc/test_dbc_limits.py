"""DBC files on which their reader would work for minutes."""

from pathlib import Path

import pytest

from drivers.protocols.dbc_codec import LayoutError, load_dbc
from tests.fuzz.__main__ import LONGEST_S, at_most


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("BO_ 1 M: 99999999 A\n", "frame length 99999999: allowed 0 to 64"),
        ('BO_ 1 M: 8 A\n SG_ S : 0|99999999@1+ (1,0) [0|1] "" B\n', "signal length 99999999"),
        ('BO_ 1 M: 8 A\n SG_ S : 9999|8@1+ (1,0) [0|1] "" B\n', "signal's first bit 9999"),
        ("SG_MUL_VAL_ 1 A B 0-4294967295;\n", "multiplexer value 4294967295"),
        ("SG_MUL_VAL_ 1 A B 0-65535;\n" * 3, "ranges have more than 131072 values together"),
        ("BU_: " + "A " * 70_000 + "\n", "more than 65536 nodes"),
        ('BO_ 1 M: 8 A\n SG_ S : 0|16@2+ (1,0) [0|1] "" B\n', "byte order 2: allowed 0 to 1"),
        ("//" + "x" * 2**20 + "\n", "longer than 1048576 bytes"),
        ('CM_ "' + "\\" * 100_000, "not a usable DBC file"),
    ],
)
def test_a_dbc_file_that_would_take_minutes_is_refused(content: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.dbc"
    path.write_text(content)
    with pytest.raises(LayoutError) as caught, at_most(LONGEST_S):
        load_dbc(path)
    assert reason in str(caught.value)
    assert len(str(caught.value)) < 1000
