"""The stability margins of a running rig's loop, for the page's Rig: seconds of work, done once a run in a process of
its own at the lowest priority.
"""

import os
from collections.abc import Mapping
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, Any, Final

from hil.cli.processes import worker_pool
from hil.rig.law_names import LAWS
from hil.rig.tables import ESTIMATORS

if TYPE_CHECKING:
    from hil.analysis.loop_corners import CornerFinding

WAIT_S: Final = 120.0
_NICEST: Final = 19


def margins(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Of a ring's metadata. rows: for each axis the nominal loop and the corner with the least margin, as
    CornerFinding.as_json has them, with what each lacks. problem: why there are none.
    """
    if not metadata:
        return {"rows": [], "problem": "no control process has left word of this rig"}
    names = metadata["rig"]["law"]["name"], metadata["rig"]["estimator"]["name"]
    if brought := [name for name in names if name not in (*LAWS, *ESTIMATORS)]:
        return {"rows": [], "problem": f"{brought[0]} is no law of hil, and the page does not run it: see hil check"}
    try:
        with worker_pool(1, "spawn") as child:
            return child.submit(_computed, dict(metadata)).result(WAIT_S)
    except (BrokenProcessPool, TimeoutError, OSError, ValueError) as error:
        return {"rows": [], "problem": f"the margins cannot be computed: {error}"}


def _computed(metadata: dict[str, Any]) -> dict[str, Any]:
    from hil.analysis.loop_corners import check_corners
    from hil.rig.provenance import rig_of_run

    os.nice(_NICEST)
    with rig_of_run(metadata) as (rig, _):
        found = check_corners(rig)
    rows = [finding for axis in rig.axes for finding in _nominal_and_least([one for one in found if one.axis == axis])]
    return {"rows": [{**finding.as_json(), "lacks": finding.shortfall()} for finding in rows], "problem": ""}


def _nominal_and_least(findings: "list[CornerFinding]") -> "list[CornerFinding]":
    """Of one axis, each once."""
    least = min(findings, key=lambda finding: (finding.stable, finding.gain_db))
    return list(dict.fromkeys([*(finding for finding in findings if finding.nominal), least]))
