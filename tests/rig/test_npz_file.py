"""Archives of arrays: what was saved comes back, and no file of a few kB fills the memory."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hil.rig.npz_file import MOST_ARRAYS, read_arrays

FREELY = 2**16


def archive(**members: bytes) -> io.BytesIO:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as made:
        for name, data in members.items():
            made.writestr(f"{name}.npy", data)
    return file


def array(header: str, data: bytes = b"") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


def test_arrays_of_every_kind_come_back_and_can_be_written(tmp_path: Path) -> None:
    saved = {
        "a": np.arange(12.0).reshape(3, 4),
        "b": np.asfortranarray(np.arange(12, dtype=np.int16).reshape(3, 4)),
        "empty": np.zeros((0, 2)),
        "one": np.array(5.0),
    }
    np.savez_compressed(tmp_path / "x.npz", **saved)
    with (tmp_path / "x.npz").open("rb") as file:
        found = read_arrays(file, FREELY)
    assert found.keys() == saved.keys()
    for name, values in saved.items():
        assert found[name].dtype == values.dtype
        assert np.array_equal(found[name], values)
    found["a"][0, 0] = 7.0


@pytest.mark.parametrize(
    ("members", "reason"),
    [
        ({"a": b"\0" * 2**27}, "unfold to"),
        ({"a": array("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}", bytes(8))}, "says to be"),
        ({"a": array("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}", bytes(8))}, "says to be"),
        ({"a": array("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", bytes(8))}, "says to be"),
        ({"a": array("{'descr': '|V0', 'fortran_order': False, 'shape': (1,)}")}, "says to be"),
        ({"a": array("{'descr': '<f8', 'fortran_order': False, 'shape': (" + "(" * 9000)}, "header"),
        ({"a": b"no array"}, "magic"),
        ({f"a{number}": b"" for number in range(MOST_ARRAYS + 1)}, "at most"),
    ],
)
def test_an_archive_that_lies_is_refused(members: dict[str, bytes], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_arrays(archive(**members), FREELY)


def test_other_compression_and_no_archive_are_refused() -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_LZMA) as made:
        made.writestr("a.npy", b"x")
    with pytest.raises(ValueError, match="deflate"):
        read_arrays(file, FREELY)
    with pytest.raises(ValueError, match="no NPZ archive"):
        read_arrays(io.BytesIO(b"time_s,x\n"), FREELY)
