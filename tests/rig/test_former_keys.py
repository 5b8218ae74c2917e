"""How a key of an earlier version is said to people: one line, while all other warnings stay as Python has them."""

import io
import warnings

import pytest

from hil.rig.former_keys import FormerKeyWarning, show_former_keys


def test_a_former_key_is_one_line_and_other_warnings_are_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # put back afterwards
    show_former_keys()
    out = io.StringIO()
    warnings.showwarning(FormerKeyWarning("rig.toml: write it so"), FormerKeyWarning, "file.py", 7, out)
    assert out.getvalue() == "hil: rig.toml: write it so\n"
    other = io.StringIO()
    warnings.showwarning(RuntimeWarning("beware"), RuntimeWarning, "file.py", 7, other, "x = 1")
    assert other.getvalue() == "file.py:7: RuntimeWarning: beware\n  x = 1\n"
