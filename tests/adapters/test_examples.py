"""The programs of docs/moving.md for Micro-Manager and Bluesky run, on the simulated rig instead of a running one."""

import re

import pytest

import hil
from hil.cycle.goal import MotionWord
from tests.adapters.windows import WINDOWS
from tests.support.paths import ROOT

BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "moving.md").read_text(), re.DOTALL)


@pytest.mark.long
@pytest.mark.parametrize("word", ["pymmcore", "ophyd"])
def test_the_page_shows_a_program_that_runs(word: str) -> None:
    (block,) = [block for block in BLOCKS if f"hil.adapters.{word}" in block]
    assert 'hil.motion("microscope-ideal")' in block
    simulated = f'hil.motion(hil.load_rig("microscope-ideal", overrides={WINDOWS!r}))'
    names: dict[str, object] = {}
    exec(block.replace('hil.motion("microscope-ideal")', simulated), names)
    mover = names["mover"]
    assert isinstance(mover, hil.VirtualMover)
    assert mover.status().motion is MotionWord.HOLD
    assert mover.status().number > 0
