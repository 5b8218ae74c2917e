"""A rig says which status bits its drives must tell; a layout without room for one is refused when the file is read."""

import pytest

from drivers.protocols.base import DriveStatus
from hil.rig.file import load_rig, rig_hash
from hil.rig.schema import RigError
from tests.support.command_line import CommandLine
from tests.support.paths import RIGS

EVERY_BIT = [(bit.name or "").lower() for bit in DriveStatus]
OF_CLASSIC = EVERY_BIT[:7]


def ask(protocol: str, bit: str) -> list[str]:
    return [f"bus.protocol={protocol}", f"axes.y.must_tell=['{bit}']"]


@pytest.mark.parametrize("bit", EVERY_BIT)
@pytest.mark.parametrize(("protocol", "carried"), [("stage_fd", EVERY_BIT), ("stage_classic", OF_CLASSIC)])
def test_a_layout_carries_a_bit_or_is_refused_with_its_name_and_the_key(
    protocol: str, carried: list[str], bit: str
) -> None:
    if bit in carried:
        assert load_rig(RIGS / "paper.toml", ask(protocol, bit)).axes["y"].must_tell == [bit]
        return
    with pytest.raises(RigError) as caught:
        load_rig(RIGS / "paper.toml", ask(protocol, bit))
    (problem,) = caught.value.problems
    assert f"bus.protocol = '{protocol}': its answers have no bit for {bit.upper()}" in problem
    assert f'which axes.y.must_tell = ["{bit}"] needs' in problem


def test_the_command_line_refuses_it_as_a_wrong_rig(hil_here: CommandLine) -> None:
    sets = [word for text in ask("stage_classic", "home") for word in ("--set", text)]
    done = hil_here("sim", "paper", *sets)
    assert done.returncode == 78
    assert 'which axes.y.must_tell = ["home"] needs' in done.stderr


def test_a_rig_that_asks_for_nothing_keeps_its_hash() -> None:
    rig = load_rig(RIGS / "paper.toml")
    assert rig_hash(load_rig(RIGS / "paper.toml", ["axes.y.must_tell=[]"])) == rig_hash(rig)
    assert rig_hash(load_rig(RIGS / "paper.toml", ask("stage_fd", "home"))) != rig_hash(rig)


def test_what_is_no_status_bit_is_refused_with_those_that_are() -> None:
    with pytest.raises(RigError) as caught:
        load_rig(RIGS / "paper.toml", ask("stage_fd", "HOME"))
    (problem,) = caught.value.problems
    assert "axes.y.must_tell.0 = 'HOME': " in problem
    assert problem.endswith(f"allowed: {', '.join(EVERY_BIT)}")
