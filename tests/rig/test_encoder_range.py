"""A travel that the position on the bus cannot carry is refused with the numbers; once y read +828 mm at -889 mm."""

from pathlib import Path

import pytest

from hil.live.run import validated
from hil.rig.bus_load import rig_layout
from hil.rig.encoder_range import encoder_range_problems
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from tests.support.judged import range_problems
from tests.support.paths import RIGS

FINE = "axes.y.encoder_resolution=4e-10"  # 2^32 counts are 1.718 m of the 2.4 m


@pytest.mark.parametrize("name", ["paper", "paper-dbc", "microscope-ideal", "odrive", "vesc", "moteus"])
def test_the_shipped_rigs_encoders_say_their_travel(name: str) -> None:
    assert range_problems(load_rig(RIGS / f"{name}.toml")) == []


@pytest.mark.parametrize("protocol", ["stage_fd", "stage_classic", "cia402"])
def test_a_count_that_wraps_within_the_travel_is_refused_before_a_bus_is_opened(protocol: str) -> None:
    with pytest.raises(RigError) as caught:
        validated(RIGS / "paper.toml", [FINE, f"bus.protocol={protocol}"])
    (problem,) = caught.value.problems
    for words in (
        "axes.y.limits.position", "from -1.22 to 1.22 m", f"{protocol} carries -0.858993 to 0.858993 m",
        "-2147483648 to 2147483647 counts", "beyond which it wraps",
    ):  # fmt: skip
        assert words in problem


def test_so_is_one_that_an_offset_moves_to_its_end() -> None:
    resolution = "axes.x.encoder_resolution=1e-9"  # 4.29 m
    assert range_problems(load_rig(RIGS / "paper.toml", [resolution])) == []
    moved = load_rig(RIGS / "paper.toml", [resolution, "axes.x.offset=1.5"])
    (problem,) = range_problems(moved)
    assert "carries -0.647484 to 3.64748 m" in problem


def test_a_signal_of_a_dbc_file_has_a_range_of_its_own(tmp_path: Path) -> None:
    text = (RIGS / "example_drive.dbc").read_text()
    (tmp_path / "example_drive.dbc").write_text(text.replace("7|32@0- (0.1,0)", "7|24@0- (0.1,0)", 1))
    rig = load_rig(RIGS / "paper-dbc.toml")
    (problem,) = encoder_range_problems(rig, rig_layout(rig, tmp_path))
    assert "axes.x.limits.position" in problem
    assert "carries -0.838861 to 0.838861 m" in problem
