"""What a motion is held against: every number of a limit worked out by hand, gravity and the margins included."""

from typing import Any

import numpy as np
import pytest

from hil.analysis.feasibility import measures, unit_questions
from hil.rig.file import load_rig
from tests.support.paths import RIGS

PERIOD = 1e-3
SETS = [
    "axes.x.rated_force=10.0",
    "axes.x.model={mass = 2.0, coulomb = 0.5, viscous = 3.0, quadratic = 4.0, gravity = -1.5}",
    "axes.x.limits={position = [-0.2, 0.3], speed = 0.5, force = 10.0, force_rate = 2000.0, following_error = 1e-3}",
]


def measured(position: float, velocity: float, *accelerations: float) -> dict[str, list[Any]]:
    """By quantity: values and limit, with their sign, of one start's instants a period apart."""
    axis = load_rig(RIGS / "paper.toml", SETS).axes["x"]
    motion = np.array([[position, velocity, a] for a in accelerations]).T[:, :, None]
    found: dict[str, list[Any]] = {}
    for measure in measures("x", axis, (motion[0], motion[1], motion[2]), PERIOD):
        found.setdefault(measure.quantity, []).append((measure.values[:, 0].tolist(), measure.limit, measure.sign))
    return found


@pytest.mark.parametrize(
    ("velocity", "acceleration", "force"),
    [
        (0.0, 0.0, 1.5),  # held against gravity
        (0.0, 1.0, 3.5),
        (0.0, -1.0, 0.5),
        (0.5, 1.0, 2.0 + 0.5 * (3.0 + 2.0) + 1.5 + 0.5),
        (-0.5, 1.0, abs(2.0 - 0.5 * (3.0 + 2.0) + 1.5 - 0.5)),
    ],
)
def test_the_force_is_that_of_inertia_friction_and_gravity(velocity: float, acceleration: float, force: float) -> None:
    ((values, limit, _),) = measured(0.0, velocity, acceleration)["force"]
    assert values == [pytest.approx(force)]
    assert limit == pytest.approx(0.85 * 10.0)


def test_the_force_changes_by_what_the_acceleration_does_and_dry_friction_is_left_out() -> None:
    ((values, limit, _),) = measured(0.0, 0.5, 1.0, 1.25, 0.25)["force rate"]
    assert values == [pytest.approx(2.0 * 0.25 / PERIOD), pytest.approx(2.0 * 1.0 / PERIOD)]
    assert limit == pytest.approx(0.85 * 2000.0)


def test_the_speed_keeps_a_margin_below_its_limit() -> None:
    ((values, limit, _),) = measured(0.0, -0.25, 0.0)["speed"]
    assert (values, limit) == ([0.25], pytest.approx(0.95 * 0.5))


@pytest.mark.parametrize(
    ("velocity", "upper", "lower"), [(0.0, 0.1, 0.1), (0.5, 0.1 + 0.25 * 0.2, 0.1), (-0.5, 0.1, 0.1 - 0.25 * 0.2)]
)
def test_the_way_to_a_stop_counts_at_the_end_it_leads_to(velocity: float, upper: float, lower: float) -> None:
    """v |v| m / F: twice what full force needs."""
    (high, low) = measured(0.1, velocity, 0.0)["position"]
    assert high == ([pytest.approx(upper)], pytest.approx(0.3 - 0.5e-3), 1.0)
    assert low == ([pytest.approx(-lower)], pytest.approx(0.2 - 0.5e-3), -1.0)


@pytest.mark.parametrize("name", ["paper", "odrive", "moteus"])
def test_nothing_is_asked_about_the_units_of_a_shipped_rig(name: str) -> None:
    assert unit_questions(load_rig(RIGS / f"{name}.toml")) == []


@pytest.mark.parametrize(("kind", "length", "force"), [("linear", "m", "N"), ("rotary", "rad", "N m")])
def test_every_quantity_has_the_unit_of_its_kind_of_axis_and_the_key_of_its_limit(
    kind: str, length: str, force: str
) -> None:
    axis = load_rig(RIGS / "paper.toml", SETS).axes["x"].model_copy(update={"kind": kind})
    found = {m.quantity: (m.unit, m.key.split(" or ")[1]) for m in measures("x", axis, (np.zeros((2, 1)),) * 3, PERIOD)}
    assert found == {
        "position": (length, "axes.x.limits.position = [-0.2, 0.3]"),
        "speed": (f"{length}/s", "axes.x.limits.speed = 0.5"),
        "force": (force, "axes.x.limits.force = 10.0"),
        "force rate": (f"{force}/s", "axes.x.limits.force_rate = 2000.0"),
    }
