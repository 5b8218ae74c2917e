"""Every rig that comes with hil may run: its traffic fits, its loop is stable, its task is possible."""

import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.rig.shipped import names


@pytest.mark.long
@pytest.mark.parametrize("name", names("rigs"))
def test_check_finds_nothing_wrong_with_it(name: str) -> None:
    checked = CliRunner().invoke(build_app("check"), ["check", name])
    assert (checked.exit_code, checked.stderr) == (0, "")
