"""Another task for a rig that is at rest: checked and planned outside the tick, so that the tick only takes it.

It lasts until the control process ends; the rig file's task is the one of the next.
"""

import json

from pydantic import ValidationError

from drivers.base.toml_file import first_problems, shown
from hil.analysis.start_ranges import start_ranges
from hil.control.trajectories import plan_task
from hil.cycle.tick import LoadedTask
from hil.rig.schema import RigConfig, RigError, TaskConfig


def rig_with_task(rig: RigConfig, document: str) -> RigConfig:
    """The rig with another [task], given as JSON. Raises RigError naming what it cannot be: key, row, column, limit."""
    try:
        whole = {**rig.model_dump(mode="json"), "task": json.loads(document)}
        return RigConfig.model_validate(whole)
    except ValidationError as error:
        raise RigError(
            first_problems(
                error.errors(include_url=False),
                lambda item: (
                    f"{'.'.join(map(str, item['loc']))} = {shown(item.get('input'))}: {item['msg']}"
                    if item["loc"]
                    else item["msg"].removeprefix("Value error, ")
                ),
            )
        ) from None
    except (ValueError, RecursionError) as error:
        raise RigError([f"task: no JSON: {error}"]) from None


def task_document(task: TaskConfig) -> str:
    """A [task] as it travels and is recorded: JSON, the same for the same task."""
    return json.dumps(task.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))


def loaded_task(rig: RigConfig) -> LoadedTask:
    """The rig's task, ready for a tick. Raises ValueError as plan_task."""
    plan = plan_task(rig.task, rig.axis_names, rig.period_ns, rig.counts)
    return LoadedTask(plan, start_ranges(rig), task_document(rig.task))
