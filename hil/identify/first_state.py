"""What a law begins its first run with, by what was identified: weights of its friction and its force along the travel.

Of the law presliding-kalman (hil/control/laws/presliding_kalman.py), whose learnt state this is. Its operators turn
round as bristles of given lengths do, so that a bristle or slip elements become their weights by least squares.

A bristle's damping adds to its force while it turns, the more the faster (LuGre: Canudas de Wit and others, IEEE TAC
40(3), 1995). The operators have no such force. So the weights are those that turn as the damped bristle does where a
motion turns round at a usual acceleration: that of a sine of the whole travel at the greatest speed. The damping
counts up to what those authors take, sigma_1 = sqrt(sigma_0 m): of a bristle of a few counts the loops show too much.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from hil.control.gain import with_defaults
from hil.control.law_registry import law_class
from hil.control.laws.friction_wave import WAVES, fine
from hil.control.laws.friction_weights import WEIGHTS
from hil.control.laws.position_table import HALF, NODES
from hil.control.laws.presliding_bank import slopes
from hil.control.nominal_model import rig_model
from hil.identify.elements import Elements
from hil.identify.estimate import Array, Estimate
from hil.identify.experiments import middle
from hil.identify.findings import Findings
from hil.identify.travel_fit import TravelCurves
from hil.identify.written import model_values
from hil.rig.file import build_rig, learning_hash, learning_hashes
from hil.rig.learnt_file import write_learnt_file
from hil.rig.schema import ModelConfig, RigConfig, RigError

LAW = "presliding-kalman"
COARSE = 4  # the operator that takes friction of which no presliding was found, as the law has it at the start
WAYS, FIRST, LAST = 200, 0.1, 10.0  # compared since a reversal: number, of the shortest reach, of the longest
SMALL = 0.05  # weight of a share, beside that of a compared way: large ones that cancel out fit no better
EVEN = 0.05  # weight of a difference between neighbouring nodes, beside that of a measured place


def with_first_state(text: str, file: Path, findings: Mapping[str, Findings], before: RigConfig) -> tuple[str, str]:
    """The text of an identified rig file that is to be `file`, naming what its law begins with, which is written beside
    it; and a line that says so, empty where its law keeps nothing. An axis that was not identified begins with what it
    had `before`. Raises OSError.
    """
    document = tomlkit.parse(text)
    law: Any = document.get("law", {})
    law.pop("learnt", None)  # which was learnt with another model
    try:
        rig = build_rig(document.unwrap(), folder=file.parent)
    except RigError as error:
        return tomlkit.dumps(document), f"nothing to begin with is written: {error}"
    if rig.law.name != LAW or rig.law.iterative_learning:
        return tomlkit.dumps(document), ""
    hashes, old = learning_hashes(rig), learning_hashes(before)
    states = dict(zip(before.axis_names, before.law.learnt_state, strict=False))
    kept = {name: states.get(name, []) if hashes[name] == old.get(name) else [] for name in rig.axis_names}
    identified = {name: state_of(rig, name, one) for name, one in findings.items() if model_values(one.found)}
    beside = file.with_suffix(".learnt.json")
    write_learnt_file(beside, rig.name, learning_hash(rig), hashes, kept | identified)
    law["learnt"] = beside.name
    return tomlkit.dumps(document), f"{beside}: what its law begins with ({', '.join(identified)})"


def state_of(rig: RigConfig, name: str, findings: Findings) -> list[float]:
    """first_state of an axis of the identified rig."""
    axis, at = rig.axes[name], rig.axis_names.index(name)
    law = law_class(rig.law)
    own = law.own_gains(rig_model(rig), rig.period_ns * 1e-9)
    given = with_defaults(law.GAINS, rig.law.effective_gains())
    gains = {key: own[key] if value is None else value for key, value in given.items()}
    finest, pitch = (float(np.broadcast_to(gains[key], len(rig.axes))[at]) for key in ("finest", "table_pitch"))
    turning = axis.limits.speed**2 / middle(axis)[1]
    return first_state(
        findings.found, findings.elements, findings.travel, axis.model, turning=turning, finest=finest, pitch=pitch
    )


def first_state(
    found: Mapping[str, Estimate], elements: Elements | None, travel: TravelCurves | None, model: ModelConfig,
    *, turning: float, finest: float, pitch: float,
) -> list[float]:  # fmt: skip
    """Weights of the law's operators (N), of the mass beyond the model's (kg), the force at every node of the tables,
    forwards and backwards (N), and the waves of hil/control/laws/friction_wave.py (N). model: that the law begins with.
    turning: acceleration of motions that turn round, m/s^2. finest, pitch: m, gains of the law. What was not found is
    as the law begins without.
    """
    friction = found["coulomb"].value if "coulomb" in found else model.coulomb
    weights = _weights(found, elements, friction, model.mass, turning, 1.0 / np.array(slopes(finest)))
    mass = [0.0] * (WEIGHTS - len(weights))
    if travel is None or not travel.position.size:
        return [*weights, *mass, *[0.0] * (2 * NODES + WAVES)]
    rest, place = travel.friction - sum(weights), travel.place + model.gravity  # which the model holds against
    sine, cosine = _wave(found, friction, pitch)
    if sine or cosine:
        angle = 2.0 * np.pi * travel.position / found["friction_period"].value
        rest = rest - (sine * np.sin(angle) + cosine * np.cos(angle))
    forward, backward = (_table(travel.position, place + way * rest, pitch) for way in (1.0, -1.0))
    return [*weights, *mass, *forward, *backward, sine, cosine, -sine, -cosine]


def _wave(found: Mapping[str, Estimate], friction: float, pitch: float) -> tuple[float, float]:
    """Sine and cosine along the travel of friction that varies with a period which is too fine for the tables, N."""
    if "friction_period" not in found or not fine(found["friction_period"].value, pitch):
        return 0.0, 0.0
    size, phase = found["friction_variation"].value * friction, found["friction_phase"].value
    return size * math.cos(phase), size * math.sin(phase)


def _weights(
    found: Mapping[str, Estimate], elements: Elements | None, friction: float, mass: float, turning: float,
    reaches: Array,
) -> list[float]:  # fmt: skip
    """Of the operators, N: as friction turns with the way since a reversal. reaches: m, of the operators."""
    ways = np.geomspace(FIRST * reaches[0], LAST * reaches[-1], WAYS)
    if elements is not None:
        limits = elements.limits / elements.limits.sum()
        turned = limits @ np.minimum(ways / elements.lengths[:, None], 2.0)
    elif "presliding" in found:
        length = found["presliding"].value
        damping = found["bristle_damping"].value / friction if "bristle_damping" in found else 0.0
        time = min(max(damping, 0.0), math.sqrt(mass * length / friction))  # s, of force over its rate
        rate = 2.0 / length * np.exp(-ways / length) * np.sqrt(2.0 * turning * ways)
        turned = _turned(ways, np.array([length]))[:, 0] + time * rate
    else:
        return [friction if operator == COARSE else 0.0 for operator in range(reaches.size)]
    rows = np.vstack([_turned(ways, reaches), SMALL * np.eye(reaches.size)])
    shares = np.linalg.lstsq(rows, np.concatenate([turned, np.zeros(reaches.size)]), rcond=None)[0]
    weights: list[float] = (shares * (friction / shares.sum())).tolist()
    return weights


def _turned(ways: Array, reaches: Array) -> Array:
    """By how much bristles of these lengths have turned after these ways, of 2 in all: (ways, reaches)."""
    turned: Array = 2.0 * (1.0 - np.exp(-ways[:, None] / reaches))
    return turned


def _table(position: Array, force: Array, pitch: float) -> list[float]:
    """The law's table through these forces, by least squares. Nodes between which nothing was measured lie on a
    straight line between their neighbours, or hold the outermost one's value.
    """
    nodes = np.arange(-HALF, HALF + 1)
    place = np.clip(position / pitch, -HALF, HALF)  # beyond its nodes the law's table holds
    shares = np.maximum(1.0 - np.abs(place[:, None] - nodes), 0.0)
    even = EVEN * np.diff(np.eye(nodes.size), axis=0)
    wanted = np.concatenate([force, np.zeros(len(even))])
    table: list[float] = np.linalg.lstsq(np.vstack([shares, even]), wanted, rcond=None)[0].tolist()
    return table
