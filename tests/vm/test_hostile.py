"""Commands beside a SCHED_FIFO 99 hog, and while the machine's clock is set: they do their work, or say why not."""

from pathlib import Path

import pytest

from tests.hostile.__main__ import Lane
from tests.hostile.surroundings import SURROUNDINGS

pytestmark = [
    pytest.mark.vcan,
    pytest.mark.skipif(
        "virtme" not in Path("/proc/cmdline").read_text(), reason="takes a core, sets the clock: only in make test-vm"
    ),
]
# Minutes each in this guest, whose cores are emulated: they run when this file is named.
LONG = ("run", "sim", "sidecar")
COMMANDS = ("events", "recover", *(pytest.param(name, marks=pytest.mark.slow) for name in LONG))


@pytest.fixture(scope="module")
def lane(tmp_path_factory: pytest.TempPathFactory) -> Lane:
    return Lane(tmp_path_factory.mktemp("hostile"))


@pytest.mark.parametrize("at", [name for name, over in SURROUNDINGS.items() if "guest" in over.needs])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_there_is_right(command: str, at: str, lane: Lane) -> None:
    why, ended = lane.tried(command, at)
    assert not why, ended
