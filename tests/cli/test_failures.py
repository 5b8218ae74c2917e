"""What ends a command in a line of text, and what is a mistake of ours and keeps its traceback."""

import errno

import pytest

from hil.cli.exit_status import EXIT_FILE, EXIT_UNAVAILABLE
from hil.cli.failures import failure


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        ImportError("x.so: failed to map segment from shared object"),
        SystemError("<function f at 0x7f> returned NULL without setting an exception"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_too_little_memory_is_told_wherever_it_shows(error: Exception) -> None:
    status, lines = failure(error)
    assert (status, len(lines)) == (EXIT_UNAVAILABLE, 1)
    assert lines[0].startswith("hil: not enough memory; `ulimit -v`")


def test_a_full_disk_is_told_with_the_file_where_it_is_known() -> None:
    assert failure(OSError(errno.ENOSPC, "No space left", "a.csv")) == (EXIT_FILE, ["hil: a.csv: No space left"])
    assert failure(OSError(errno.ENOSPC, "No space left")) == (EXIT_FILE, ["hil: No space left"])


def test_where_no_temporary_file_can_be_written_the_folders_are_told() -> None:
    said = "No usable temporary directory found in ['/tmp', '/home/ana']"
    assert failure(FileNotFoundError(errno.ENOENT, said)) == (EXIT_FILE, [f"hil: {said}"])


@pytest.mark.parametrize(
    "error", [OSError(errno.EINVAL, "Invalid argument"), ImportError("no module"), SystemError("x")]
)
def test_a_mistake_of_ours_is_raised_as_it_is(error: Exception) -> None:
    with pytest.raises(type(error)) as caught:
        failure(error)
    assert caught.value is error
