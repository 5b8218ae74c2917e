"""Every data type of CiA 301, table 44: numbers as files write them, and the bytes of all values, both ways."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.eds.data_types import DATA_TYPES, Kind, integer

SIGNED = {0x02: 8, 0x03: 16, 0x10: 24, 0x04: 32, 0x12: 40, 0x13: 48, 0x14: 56, 0x15: 64}
UNSIGNED = {0x05: 8, 0x06: 16, 0x16: 24, 0x07: 32, 0x18: 40, 0x19: 48, 0x1A: 56, 0x1B: 64}
WHOLE = SIGNED | UNSIGNED


def test_the_types_are_those_of_the_standard() -> None:
    numbers = {number: data_type.bits for number, data_type in DATA_TYPES.items() if data_type.kind is Kind.INTEGER}
    assert numbers == {0x01: 1, 0x0C: 48, 0x0D: 48, **WHOLE}
    assert {number for number, data_type in DATA_TYPES.items() if data_type.signed} == SIGNED.keys()
    assert {number for number in DATA_TYPES if not DATA_TYPES[number].size} == {0x09, 0x0A, 0x0B, 0x0F}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0", 0),
        ("017", 15),  # octal
        ("0x1F", 31),
        ("0X1f", 31),
        ("-12", -12),
        (" 7 ", 7),
        ("$NODEID+0x180", 0x185),
        ("0x180+$NODEID", 0x185),
        ("0x180 + $NodeID", 0x185),
        ("$NODEID", 5),
        ("0x40000000+$nodeid+0x180", 0x40000185),
    ],
)
def test_numbers_in_every_spelling(text: str, value: int) -> None:
    assert integer(text, 5) == value


@pytest.mark.parametrize("text", ["", "0.0", "08", "1_000", "0x", "torque", "$NODEID*2", "1 2", "++1", "0x-1"])
def test_what_is_no_number(text: str) -> None:
    with pytest.raises(ValueError, match="no number"):
        integer(text, 5)


@pytest.mark.parametrize(("number", "bits"), SIGNED.items())
@given(data=st.data())
def test_hexadecimal_of_signed_types_is_twos_complement(number: int, bits: int, data: st.DataObject) -> None:
    value = data.draw(st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1))
    written = f"{value % 2**bits:#x}"
    assert DATA_TYPES[number].parse(written) == value
    assert DATA_TYPES[number].parse(str(value)) == value
    for width in (32, 64):
        if value < 0 and width > bits:  # sign-extended, as some editors write it
            assert DATA_TYPES[number].parse(f"{value % 2**width:#X}") == value


@pytest.mark.parametrize(("number", "bits"), WHOLE.items())
def test_what_a_type_cannot_hold_is_refused(number: int, bits: int) -> None:
    low, high = DATA_TYPES[number].range
    for value in (low - 1, high + 1):
        with pytest.raises(ValueError, match=f"not within {DATA_TYPES[number].name}"):
            DATA_TYPES[number].parse(str(value))


@pytest.mark.parametrize(("number", "bits"), WHOLE.items())
@given(data=st.data())
def test_numbers_of_every_width_survive_the_bus(number: int, bits: int, data: st.DataObject) -> None:
    data_type = DATA_TYPES[number]
    value = data.draw(st.integers(*data_type.range))
    packed = data_type.pack(value)
    assert len(packed) == bits // 8
    assert data_type.unpack(packed) == value
    wide = struct.pack("<q" if data_type.signed else "<Q", value)
    assert packed == wide[: bits // 8]  # little endian, cut


@pytest.mark.parametrize("text", ["0x3F800000", "nan", "inf", "1e39", "one"])
def test_what_is_no_real(text: str) -> None:
    with pytest.raises(ValueError, match=r"REAL32|finite"):
        DATA_TYPES[0x08].parse(text)


def test_reals_strings_and_domains() -> None:
    assert DATA_TYPES[0x08].pack(DATA_TYPES[0x08].parse("-1.5e3")) == struct.pack("<f", -1500.0)
    assert math.isclose(float(DATA_TYPES[0x11].parse("1e300")), 1e300)
    assert DATA_TYPES[0x09].pack(DATA_TYPES[0x09].parse("µ drive")) == b"\xb5 drive"
    assert DATA_TYPES[0x0B].pack(DATA_TYPES[0x0B].parse("Ω")) == b"\xa9\x03"
    for text in ("01 02 ff", "0102FF", "0x0102ff"):
        assert DATA_TYPES[0x0A].parse(text) == DATA_TYPES[0x0F].parse(text) == b"\x01\x02\xff"
    with pytest.raises(ValueError, match="hexadecimal bytes"):
        DATA_TYPES[0x0A].parse("012")
