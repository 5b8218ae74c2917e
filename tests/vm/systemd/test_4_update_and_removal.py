"""Section 8 of the page for the rig: a newer package, and the way out. Then: was every command on the page followed?"""

from pathlib import Path

import pytest

from tests.vm.systemd.page import commands, follow, followed, sections
from tests.vm.systemd.service import eventually, sh
from tests.vm.systemd.stage import STAGE

pytestmark = [pytest.mark.vcan, pytest.mark.systemd]

NEWER = "99.0"


def test_section_8_update_and_removal():
    STAGE.activate()
    before, pid = STAGE.file.read_text(), STAGE.control.pid
    recordings = set(Path("/var/lib/hil").rglob("*.mcap"))
    assert recordings

    def updated_and_still_running(output: str) -> None:
        assert NEWER in sh("dpkg-query -W hil")
        assert STAGE.file.read_text() == before
        assert STAGE.control.pid == pid, "a stage may be moving: when to restart is the operator's decision"
        assert "the old version still runs" in output

    def restarted(output: str) -> None:
        eventually(lambda: STAGE.control.pid not in (0, pid), "another process")
        STAGE.wait_for("CONNECTED", "READY", "FAULT")
        assert not STAGE.shows("ACTIVE")

    def removed(output: str) -> None:
        assert not Path("/usr/bin/hil").exists()
        units = Path("/etc/systemd/system")
        assert not [path for path in units.rglob("hil*") if path.is_symlink()], "nothing starts it any more"
        assert not list(units.glob(f"hil-*@{STAGE.name}.*"))
        assert not list(Path("/etc/systemd/network").glob("80-hil-*"))
        assert STAGE.file.read_text() == before, "the rig file is the user's"
        assert recordings <= set(Path("/var/lib/hil").rglob("*.mcap"))

    follow(
        "8",
        {"RIG": str(STAGE.file), "./hil_NEWER.deb": f"./upgrade/hil_{NEWER}.deb"},
        {
            "hil command RIG stop": lambda _: STAGE.to_ready(),
            "apt install": updated_and_still_running,
            "systemctl restart": restarted,
            "systemctl stop": lambda _: no_process_is_left(),
            "apt remove": removed,
        },
    )


def no_process_is_left() -> None:
    for unit in (STAGE.control, STAGE.sidecar):
        assert unit.state == "inactive", unit
    assert STAGE.control.show("ExecMainStatus") == "0", "SIGTERM ends it in zero torque and status 0"


def test_the_whole_page_was_followed():
    assert followed == [number for number in sorted(sections()) if commands(number)]
