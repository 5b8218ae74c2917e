"""Another task or law for a rig that is at rest: checked and planned outside the tick, so that the tick only takes it.

It lasts until the control process ends; those of the rig file are those of the next.
"""

import json
from typing import Any

import numpy as np
from pydantic import ValidationError

from drivers.base.toml_file import first_problems, own_words, shown
from hil.analysis.start_ranges import start_ranges
from hil.control.law_registry import is_built_in
from hil.control.laws import designed_laws, make_axis_laws
from hil.control.nominal_model import rig_model
from hil.control.trajectories import plan_task
from hil.cycle.tick import LoadedLaw, LoadedTask
from hil.rig.law_names import LAWS
from hil.rig.schema import LawConfig, RigConfig, RigError, TaskConfig


def rig_with_task(rig: RigConfig, document: str) -> RigConfig:
    """The rig with another [task], given as JSON. Raises RigError naming what it cannot be: key, row, column, limit."""
    return _rig_with(rig, "task", document)


def rig_with_law(rig: RigConfig, document: str) -> RigConfig:
    """The rig with another [law], given as JSON. Raises RigError naming key, value and allowed range, or what a rig
    that runs cannot take.
    """
    other = _rig_with(rig, "law", document)
    law = other.law
    if law.iterative_learning or rig.law.iterative_learning:
        raise RigError(["law.iterative_learning = true: a law that learns is not set while the rig runs"])
    if not is_built_in(law):
        known = ", ".join(LAWS)
        raise RigError([f"law.name = {shown(law.name)}: while the rig runs, one of hil's own laws is set: {known}"])
    return other


def _rig_with(rig: RigConfig, table: str, document: str) -> RigConfig:
    try:
        whole = {**rig.model_dump(mode="json"), table: json.loads(document)}
        return RigConfig.model_validate(whole)
    except ValidationError as error:
        raise RigError(
            first_problems(
                error.errors(include_url=False),
                lambda item: (
                    f"{'.'.join(map(str, item['loc']))} = {shown(item.get('input'))}: {own_words(item['msg'])}"
                    if item["loc"]
                    else own_words(item["msg"])
                ),
            )
        ) from None
    except (ValueError, RecursionError) as error:
        raise RigError([f"{table}: no JSON: {error}"]) from None


def task_document(task: TaskConfig) -> str:
    """A [task] as it travels and is recorded: JSON, the same for the same task."""
    return json.dumps(task.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))


def law_document(law: LawConfig) -> str:
    """A [law] as it travels and is recorded: its name and the gains that count, as JSON."""
    table: dict[str, Any] = {"name": law.name, "gains": law.effective_gains()}
    if law.iterative_learning:
        table["iterative_learning"] = True
    return json.dumps(table, sort_keys=True, separators=(",", ":"))


def loaded_task(rig: RigConfig) -> LoadedTask:
    """The rig's task, ready for a tick. Raises ValueError as plan_task."""
    plan = plan_task(rig.task, rig.axis_names, rig.period_ns, rig.counts)
    return LoadedTask(plan, start_ranges(rig), task_document(rig.task))


def loaded_law(rig: RigConfig) -> LoadedLaw:
    """The rig's law, ready for a tick, with what takes long to find. Raises ValueError as make_axis_laws."""
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    laws = make_axis_laws(rig.law, rig_model(rig), rig.period_ns * 1e-9, limit)
    return LoadedLaw(rig.law, designed_laws(laws), law_document(rig.law))
