"""EDS and DCF files as CiA 306-1 has them, and as they come: a broken value costs that value and a warning."""

from pathlib import Path

import pytest

from drivers.eds.reader import Eds, EdsError, Entry, read_eds

HEAD = "[DeviceInfo]\nVendorName=Maker\nProductName=Small\nBaudRate_500=1\n"
TYPE = "[1000]\nParameterName=Device type\nDataType=0x0007\nAccessType=ro\nDefaultValue=0x20192\n"


def section(name: str, **keys: str) -> str:
    """One section; a variable of 16 bits where the keys say nothing else."""
    stated = {"ParameterName": "p", "DataType": "0x0003", "AccessType": "rw"} | keys
    return f"[{name}]\n" + "".join(f"{key}={value}\n" for key, value in stated.items())


def entry(eds: Eds, index: int, subindex: int = 0) -> Entry:
    found = eds.entry(index, subindex)
    assert found is not None
    return found


def read(*parts: str, node: int = 5) -> Eds:
    return Eds("".join((HEAD, TYPE, *parts)), node)


@pytest.mark.parametrize(
    ("data_type", "low", "high", "limits"),
    [
        ("0x0002", "0x80", "0x7F", (-128, 127)),
        ("0x0003", "0x8000", "0x7FFF", (-32768, 32767)),
        ("0x0003", "0xFFFF8000", "0x00007FFF", (-32768, 32767)),
        ("0x0010", "0x800000", "0x7FFFFF", (-(2**23), 2**23 - 1)),
        ("0x0004", "0x80000000", "0x7FFFFFFF", (-(2**31), 2**31 - 1)),
        ("0x0015", "0x8000000000000000", "010", (-(2**63), 8)),
        ("0x0006", "0", "0xFFFF", (0, 65535)),
        ("0x0008", "-1.5", "2", (-1.5, 2.0)),
        ("0x0009", "0", "9", (None, None)),  # of a string
    ],
)
def test_limits_are_numbers_of_their_type(
    data_type: str, low: str, high: str, limits: tuple[float | None, float | None]
) -> None:
    eds = read(section("2000", DataType=data_type, LowLimit=low, HighLimit=high))
    assert (entry(eds, 0x2000).low, entry(eds, 0x2000).high) == limits
    assert not eds.warnings


def test_limits_that_exclude_everything_are_none_and_told() -> None:
    eds = read(section("2000", LowLimit="0", HighLimit="0xFFFF"))  # as if it were unsigned
    assert (entry(eds, 0x2000).low, entry(eds, 0x2000).high) == (None, None)
    assert "above HighLimit" in eds.warnings[0]


@pytest.mark.parametrize(("text", "mappable"), [("0", 0), ("0x0", 0), ("00", 0), ("1", 1), ("0x1", 1)])
def test_mapping_is_a_number_like_any(text: str, mappable: int) -> None:
    assert entry(read(section("2000", PDOMapping=text)), 0x2000).mappable == bool(mappable)


@pytest.mark.parametrize(
    ("key", "text", "left"),
    [
        ("DefaultValue", "0.0", (None, 1, 9, True)),
        ("LowLimit", "low", (7, None, 9, True)),
        ("HighLimit", "70000", (7, 1, None, True)),
        ("PDOMapping", "yes", (7, 1, 9, False)),
        ("ObjectType", "VAR", (7, 1, 9, True)),
    ],
)
def test_a_broken_value_costs_that_value_and_a_warning(key: str, text: str, left: tuple[object, ...]) -> None:
    sound = {"DefaultValue": "7", "LowLimit": "1", "HighLimit": "9", "PDOMapping": "1"}
    eds = read(section("2000", **(sound | {key: text})))
    found = entry(eds, 0x2000)
    assert (found.value, found.low, found.high, found.mappable) == left
    assert len(eds.warnings) == 1
    assert eds.warnings[0].startswith("2000h:00: " + key)


@pytest.mark.parametrize(
    "broken", ["DataType=0x0003\nAccessType=maybe", "AccessType=rw", "DataType=long\nAccessType=rw"]
)
def test_an_entry_without_type_or_access_is_told_to_whoever_needs_it(broken: str) -> None:
    eds = read(f"[2000]\nParameterName=p\n{broken}\n")
    assert eds.entry(0x2000) is None
    assert (0x2000, 0) in eds.broken
    assert eds.value(0x1000) == 0x20192


def test_a_type_that_the_standard_does_not_have_is_bytes_or_what_the_file_defines() -> None:
    defined = "[A0sub1]\nParameterName=Type\nDataType=0x0005\nAccessType=ro\nDefaultValue=0x0006\n"
    eds = read(section("2000", DataType="0x00A0"), defined, section("2001", DataType="0x0099"))
    assert (entry(eds, 0x2000).data_type, entry(eds, 0x2001).data_type) == (0x06, 0x0F)
    assert ["2001h" in warning for warning in eds.warnings] == [True]


def test_compact_arrays_have_their_members_with_names_and_values() -> None:
    eds = read(
        "[2014]\nParameterName=Array\nObjectType=0x8\nDataType=0x0016\nAccessType=rw\nDefaultValue=7\nCompactSubObj=3\n",
        "[2014Name]\nNrOfEntries=1\n2=Second\n",
        "[2014Value]\nNrOfEntries=2\n1=0x11\n0x3=bad\n",
    )
    members = [entry(eds, 0x2014, sub) for sub in range(4)]
    assert [member.value for member in members] == [3, 0x11, 7, None]
    assert [member.name for member in members] == ["entries", "Array_1", "Second", "Array_3"]
    assert [member.data_type for member in members] == [5, 0x16, 0x16, 0x16]
    assert eds.entry(0x2014, 4) is None
    assert len(eds.warnings) == 1


def test_domains_need_neither_type_nor_access() -> None:
    found = entry(read("[2000]\nParameterName=Program\nObjectType=0x2\n"), 0x2000)
    assert (found.data_type, found.access, found.size) == (0x0F, "rw", 0)


@pytest.mark.parametrize(
    "clutter",
    [
        "[Comments]\nLines=9\nLine1=only one\n",
        "[Comments]\nLine1=[1000]\n",
        "a line of its own\n",
        "[DummyUsage]\nDummy0003=x\n",
        "[1000sub]\nDataType=x\n",
        "[2000\nx=1\n",
    ],
)
def test_clutter_costs_nothing_else(clutter: str) -> None:
    assert read(clutter, section("2001", DefaultValue="3 ; three")).value(0x2001) == 3


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
def test_any_encoding(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "made.eds"
    path.write_bytes((HEAD.replace("Small", "Größe") + TYPE).encode(encoding))
    assert read_eds(path).product == "Größe"


def test_dummies_and_bit_rates() -> None:
    eds = read("[DummyUsage]\nDummy0003=0x1\nDummy0006=1\nDummy0007=0\n")
    assert eds.dummies == {3, 6}
    assert eds.bitrates == {500: True}
    assert (eds.rules_out(500_000), eds.rules_out(1_000_000)) == (False, False)  # of 1000 it says nothing
    assert read("[DeviceInfo]\nBaudRate_1000=0\n").rules_out(1_000_000)


def test_a_file_that_names_no_bit_rate_rules_none_out() -> None:
    eds = Eds(HEAD.replace("=1", "=0") + TYPE, 1)
    assert not eds.rules_out(500_000)
    assert "names no bit rate" in eds.bitrate_notes(500_000)[0]


def test_a_dcf_names_its_node_and_its_bit_rate() -> None:
    eds = read("[DeviceComissioning]\nNodeID=0x05\nBaudrate=250\n")
    assert (eds.own_node, eds.own_bitrate, eds.warnings) == (5, 250, [])
    assert eds.bitrate_notes(250_000) == []
    assert "written for 250 kbit/s" in eds.bitrate_notes(1_000_000)[0]
    assert not eds.rules_out(250_000)


COMMISSIONED = "[DeviceComissioning]\nNodeID=5\n"


@pytest.mark.parametrize(
    ("name", "default", "own", "for_9"),
    [
        ("1014", "$NODEID+0x80", "0x85", 0x89),
        ("1400sub1", "0x200+$NODEID", "0x205", 0x209),
        ("1401sub1", "$NODEID+0x80000300", "0x305", 0x309),  # switched on by the DCF, at its own node
        ("1800sub1", "$NODEID+0x40000180", "0x40000185", 0x40000189),
        ("1801sub1", "", "0xC0000285", 0xC0000289),
        ("1200sub1", "$NODEID+0x600", "0x605", 0x609),
        ("1402sub1", "$NODEID+0x400", "0x401", 0x401),  # not its own: another node's, as with a shared RPDO
        ("1402sub1", "", "0x20000405", 0x20000405),  # 29 bits
        ("2000", "$NODEID+7", "12", 16),
        ("2001", "", "5", 5),
        ("2002", "1", "$NODEID+1", 10),
    ],
)
def test_what_a_dcf_says_of_its_own_node_moves_and_is_told(name: str, default: str, own: str, for_9: int) -> None:
    text = section(name, DataType="0x0007", DefaultValue=default, ParameterValue=own)
    place = int(name[:4], 16), int(name[7:] or "0", 16)
    moved, as_it_is = read(COMMISSIONED, text, node=9), read(COMMISSIONED, text, node=5)
    assert moved.value(*place) == for_9
    assert as_it_is.entry(*place) is not None
    assert "written for node 5; read for node 9" in moved.warnings[0]
    assert not as_it_is.warnings
    if "NODEID" not in own:
        assert as_it_is.value(*place) == int(own, 0)


def test_what_is_no_eds() -> None:
    with pytest.raises(EdsError, match="no object"):
        Eds("hello\n", 1)
