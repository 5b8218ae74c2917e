"""Words for what failed: the system's, the exception's own, or its kind's name; never none."""

import pytest

from drivers.base.text_file import words_of


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (TimeoutError(), "TimeoutError"),
        (OSError(), "OSError"),
        (ValueError("out of range"), "out of range"),
        (OSError("no errno"), "no errno"),
        (PermissionError(13, "Permission denied", "/etc/shadow"), "Permission denied"),
    ],
)
def test_no_failure_is_told_without_words(error: Exception, words: str) -> None:
    assert words_of(error) == words
