"""The stability margins of a running rig's loop, for the page's Rig: seconds of work, done once a run in a process of
its own at the lowest priority.
"""

import asyncio
import json
import os
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from hil.cli.processes import die_with_parent
from hil.rig.law_names import LAWS
from hil.rig.tables import ESTIMATORS

if TYPE_CHECKING:
    from hil.analysis.loop_corners import CornerFinding

WAIT_S: Final = 120.0
_NICEST: Final = 19


async def margins(metadata: Mapping[str, Any], wait_s: float = WAIT_S) -> dict[str, Any]:
    """Of a ring's metadata. rows: for each axis the nominal loop and the corner with the least margin, as
    CornerFinding.as_json has them, with what each lacks. problem: why there are none. wait_s: for the process, s; it
    ends with the call, however that ends.
    """
    if not metadata:
        return _none("no control process has left word of this rig")
    names = metadata["rig"]["law"]["name"], metadata["rig"]["estimator"]["name"]
    if brought := [name for name in names if name not in (*LAWS, *ESTIMATORS)]:
        return _none(f"{brought[0]} is no law of hil, and the page does not run it: see hil check")
    pipe = asyncio.subprocess.PIPE
    command = sys.executable, "-m", __name__, str(os.getpid())
    child = await asyncio.create_subprocess_exec(*command, stdin=pipe, stdout=pipe, stderr=pipe)
    try:
        found, said = await asyncio.wait_for(child.communicate(json.dumps(metadata).encode()), wait_s)
    except TimeoutError:
        return _none(f"this computer is too busy: they took more than {wait_s:g} s; hil check computes them, too")
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    if child.returncode:
        last = said.decode(errors="replace").strip().rpartition("\n")[2]
        return _none(f"the margins cannot be computed: {last or f'exit status {child.returncode}'}")
    rows: dict[str, Any] = json.loads(found)
    return rows


def _none(problem: str) -> dict[str, Any]:
    return {"rows": [], "problem": problem}


def _computed(metadata: dict[str, Any]) -> dict[str, Any]:
    from hil.analysis.loop_corners import check_corners
    from hil.rig.provenance import rig_of_run

    with rig_of_run(metadata) as (rig, _):
        found = check_corners(rig)
    rows = [finding for axis in rig.axes for finding in _nominal_and_least([one for one in found if one.axis == axis])]
    return {"rows": [{**finding.as_json(), "lacks": finding.shortfall()} for finding in rows], "problem": ""}


def _nominal_and_least(findings: "list[CornerFinding]") -> "list[CornerFinding]":
    """Of one axis, each once."""
    least = min(findings, key=lambda finding: (finding.stable, finding.gain_db))
    return list(dict.fromkeys([*(finding for finding in findings if finding.nominal), least]))


if __name__ == "__main__":
    die_with_parent(int(sys.argv[1]))
    os.nice(_NICEST)
    json.dump(_computed(json.load(sys.stdin)), sys.stdout)
