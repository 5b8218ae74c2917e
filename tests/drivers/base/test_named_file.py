"""What is written whole: its bytes, its folder, and the name in its error."""

from pathlib import Path

import pytest

from drivers.base.named_file import save_picture, write_text


class Full:
    """A figure for a disk that is full."""

    def savefig(self, path: Path, dpi: int) -> None:
        raise OSError(28, "No space left on device")


def test_a_text_is_written_as_it_was_read_even_where_it_is_no_utf_8(tmp_path: Path) -> None:
    (tmp_path / "latin.dbc").write_bytes(b"BU_: Antri\xebb\n")
    text = (tmp_path / "latin.dbc").read_text(encoding="utf-8", errors="surrogateescape")
    write_text(tmp_path / "copy.dbc", text)
    assert (tmp_path / "copy.dbc").read_bytes() == b"BU_: Antri\xebb\n"


def test_a_full_disk_is_told_with_the_file_s_name(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No space left") as told:
        write_text("/dev/full", "x" * 100_000)
    assert told.value.filename == "/dev/full"
    with pytest.raises(OSError, match="No space left") as told:
        save_picture(Full(), tmp_path / "new" / "a.png")
    assert told.value.filename == str(tmp_path / "new" / "a.png")


def test_the_folder_of_a_picture_is_made(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    save_picture(Figure(), tmp_path / "runs" / "today" / "a.png", dpi=20)
    assert (tmp_path / "runs" / "today" / "a.png").read_bytes().startswith(b"\x89PNG")
