"""A law that was typed into a notebook: a class, no file."""

import linecache
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import hil
from hil.runs.class_text import class_text

CELL = """
import math
import numpy as np
from hil import Gain, Law

STIFF = 0.03

def pull(model, error):
    return STIFF * model.mass * error * 1e6

class Soft(Law):
    GAINS = {"damping": Gain(0.2, least=0.0)}

    def __init__(self, model, period, force_limit, damping=0.2):
        self.model, self.kd = model, damping * model.mass / period

    def reset(self, position, force):
        pass

    def force(self, inputs):
        start = inputs.start
        known = self.model.mass * inputs.mean_acceleration + self.model.coulomb * inputs.mean_sign
        rate = math.fabs(1.0) * (start.velocity - inputs.velocity_estimate)
        return float(np.float64(known + pull(self.model, start.position - inputs.position_estimate) + self.kd * rate))

open_file = open(__file__) if False else iter(())

class Leaky(Soft):
    def force(self, inputs):
        return next(open_file)
"""


@pytest.fixture
def cell() -> Iterator[dict[str, Any]]:
    """The names of a module that no file holds, as a notebook's are."""
    module = ModuleType("cell_of_a_notebook")  # without __file__, as IPython's is
    linecache.cache["<cell 1>"] = (len(CELL), None, CELL.splitlines(keepends=True), "<cell 1>")
    sys.modules[module.__name__] = module
    exec(compile(CELL, "<cell 1>", "exec"), module.__dict__)
    yield module.__dict__
    del sys.modules[module.__name__], linecache.cache["<cell 1>"]


def test_a_class_of_a_cell_runs_and_its_recording_replays(cell: dict[str, Any], tmp_path: Any) -> None:
    run = hil.simulate("paper", 1.0, law=cell["Soft"], record=tmp_path / "run.mcap")
    assert run.rig.law.name == "./soft.py:Soft"
    assert not run.law_failure
    assert run.summary()["axes"]["x"]["max_error"] < 1e-3
    assert hil.Recording(tmp_path / "run.mcap").rig.law.source == class_text(cell["Soft"])


def test_the_text_of_a_class_is_a_file_of_its_own(cell: dict[str, Any]) -> None:
    names: dict[str, Any] = {}
    exec(class_text(cell["Soft"]), names)
    assert names["STIFF"] == 0.03
    assert names["Soft"].GAINS == cell["Soft"].GAINS


def test_what_a_file_cannot_say_is_refused_by_name(cell: dict[str, Any]) -> None:
    with pytest.raises(hil.RigError, match="law = Leaky: Leaky uses open_file, a tuple_iterator"):
        hil.load_rig("paper").changed(law=cell["Leaky"])


def test_overrides_of_the_law_are_those_of_the_class(cell: dict[str, Any]) -> None:
    rig = hil.load_rig("paper").changed("plant.mass_scale=1.25", "law.gains.damping=0.3", law=cell["Soft"])
    assert (rig.config.law.gains, rig.config.plant.mass_scale) == ({"damping": 0.3}, 1.25)
    with pytest.raises(hil.RigError, match=r"stiffness"):
        hil.simulate("paper", 0.1, law=cell["Soft"], overrides={"law.gains.stiffness": 1.0})


def test_values_may_be_numbers_lists_and_arrays() -> None:
    rig = hil.load_rig("paper", {"plant.mass_scale": 1.25, "plant.mass": np.array([0.02, 0.01])})
    rig = rig.changed({"law.name": "structured-kalman"}, rate_hz=500).changed("plant.friction_scale=0.5")
    config = rig.config
    assert (config.plant.mass_scale, config.plant.mass, config.rate_hz) == (1.25, [0.02, 0.01], 500.0)
    assert (config.law.name, config.plant.friction_scale) == ("structured-kalman", 0.5)


def test_a_value_that_no_rig_file_can_hold_is_refused_in_one_line() -> None:
    for value in (object(), float("nan"), {1, 2}):
        with pytest.raises(hil.RigError, match=r"^overrides: "):
            hil.load_rig("paper", {"plant.mass_scale": value})


def test_a_run_says_what_it_is() -> None:
    assert repr(hil.simulate("paper", 0.2)) == "<Simulation of paper, pd-feedforward: 0.199 s, ended ACTIVE>"
    assert repr(hil.load_rig("paper")) == "<Rig paper: axes x, y; 1000 Hz; pd-feedforward>"
