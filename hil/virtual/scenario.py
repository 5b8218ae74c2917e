"""Scenario files against a rig: every name in them is checked before a run begins."""

from pathlib import Path

import numpy as np

from hil.control.trajectories import make_trajectory
from hil.cycle.state_machine import State
from hil.rig.schema import RigConfig, RigError
from sim_plant.scenario.injector import Scenario, ScenarioError
from sim_plant.scenario.injector import load_scenario as load


def load_scenario(path: Path, rig: RigConfig) -> Scenario:
    """Read a scenario for this rig. Raises RigError with every problem, each naming key, value and what is allowed."""
    try:
        scenario = load(path)
    except ScenarioError as error:
        raise RigError(error.problems) from None
    try:
        trajectory = make_trajectory(rig.task, rig.axis_names, np.zeros(len(rig.axes)), rig.period_ns, rig.counts)
    except ValueError as error:  # a task this rig cannot have; the text names its keys
        raise RigError([f"rig {rig.name}: {error}"]) from None
    try:
        scenario.check(rig.axis_names, [state.name for state in State], trajectory.phase_names, list(rig.sensors))
    except ScenarioError as error:
        raise RigError([f"{path}: {line}" for line in error.problems]) from None
    return scenario
