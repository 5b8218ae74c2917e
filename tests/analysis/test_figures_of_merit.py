"""Errors and forces of a run in a few numbers."""

import math

import numpy as np
import pytest

from hil.analysis.figures_of_merit import axis_statistics


def test_figures_are_of_the_samples_that_came_and_of_all_forces() -> None:
    error = np.array([[3.0, 0.0], [np.nan, 1.0], [-4.0, 0.0], [1.0, 0.0]])
    force = np.array([[0.0, 1.0], [2.0, 1.0], [-5.0, 1.0], [-5.0, 1.0]])
    found = axis_statistics(["x", "y"], error, force)
    assert found["x"] == {
        "max_error": 4.0, "rms_error": pytest.approx(math.sqrt(26.0 / 3.0)), "plateau_error": 3.0, "peak_force": 5.0,
        "chatter": pytest.approx(math.sqrt(53.0 / 3.0)),
    }  # fmt: skip
    assert (found["y"]["peak_force"], found["y"]["chatter"]) == (1.0, 0.0)


def test_a_run_without_ticks_has_no_errors_and_no_force() -> None:
    found = axis_statistics(["x"], np.empty((0, 1)), np.empty((0, 1)))["x"]
    assert math.isnan(found["max_error"])
    assert (found["peak_force"], found["chatter"]) == (0.0, 0.0)
