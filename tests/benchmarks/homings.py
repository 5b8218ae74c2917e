"""Homings of each kind, from drawn places: `python -m tests.benchmarks.homings --count 100 [--only switch,stop]`.

The table stands anywhere around the place, on the switch too; its counter was switched on anywhere. Contacts are sound,
bouncing, dead, stuck or inverted. Prints how many were homed, by how much their positions differ, the greatest way, and
how many ended in HOMING_FAILED. Exit status 1 where one ends otherwise, goes further than farthest, or repeats worse
than 20 um, or one count of an index.
"""

import argparse
import random
import sys
import tempfile
from pathlib import Path

from hil.cycle.fault_table import Fault
from tests.drivers.families.cia402.test_homing_mode import rig_of as method_rig
from tests.drivers.families.cia402.test_touch_probe import rig_of as probe_rig
from tests.support.homing import FARTHEST, PLACE, Homed, home_once, homing_rig
from tests.support.odrive_homing import rig_of as odrive_rig

KINDS = (
    *(("switch", contact) for contact in ("sound", "bouncing", "dead", "stuck", "inverted")),
    *(("limit", contact) for contact in ("sound", "bouncing", "dead", "stuck", "inverted")),
    *((by, "sound") for by in ("index", "stop", "drive", "here", "absolute")),
    *(("probe", contact) for contact in ("sound", "dead", "stuck")),
    ("method", "sound"),
    *(("odrive", contact) for contact in ("sound", "bouncing", "dead", "stuck", "inverted")),
)
WORKS = ("sound", "bouncing")
# an index by a touch probe, by the drive's own homing, and an ODrive's on its endstop
BOUGHT = {"probe": probe_rig, "method": method_rig, "odrive": odrive_rig}
WITHIN = {"index": 1e-7, "probe": 1e-7, "method": 1e-7, "drive": 1e-7, "absolute": 1e-7}  # m: a count
NEAR = 20e-6  # m
BEFORE, BEHIND = 0.06, 0.03  # m: how far from the place the table may stand, and how far beyond it


def one(by: str, contact: str, draw: random.Random) -> Homed:
    """From a place drawn."""
    behind = 0.0 if by in ("index", "stop", *BOUGHT) else BEHIND
    start = PLACE + draw.uniform(-behind, BEFORE)
    if by in ("switch", "limit") and draw.random() < 0.1:
        start = PLACE + draw.uniform(-6e-6, 6e-6)  # on the edge of the switch itself
    with tempfile.TemporaryDirectory() as folder:
        zero = draw.uniform(-0.05, 0.05)
        if by in BOUGHT:
            stated = {} if by == "method" else {"contact": contact, "zero": round(zero * 1e7) * 1e-7}
            rig = BOUGHT[by](Path(folder), start=start, **stated)
        else:
            rig = homing_rig(by, Path(folder), contact=contact, start=start, zero=zero)
        _, homed = home_once(rig, Path(folder))
    return homed._replace(off=homed.off + start if by == "here" else homed.off)


def told(by: str, contact: str, count: int, seed: int) -> bool:
    """Print a line of one kind; whether it holds what it should."""
    runs = [one(by, contact, random.Random(f"{seed} {by} {contact} {k}")) for k in range(count)]
    homed = [run for run in runs if run.known and run.fault is Fault.NONE]
    failed = [run for run in runs if run.fault is Fault.HOMING_FAILED and not run.known]
    offs = [run.off for run in homed]
    spread = max(offs) - min(offs) if offs else 0.0
    way = max(run.way for run in runs)
    good = len(homed) + len(failed) == count and way <= FARTHEST and spread <= WITHIN.get(by, NEAR) * 1.01
    good = good and (not failed if contact in WORKS else True)
    others = sorted({run.fault.name for run in runs} - {"NONE", "HOMING_FAILED"})
    print(
        f"{by:9} {contact:9} homed {len(homed):3}  HOMING_FAILED {len(failed):3}  others {','.join(others) or '-':12} "
        f"spread {spread * 1e6:7.3f} um  way {way * 1e3:6.2f} of {FARTHEST * 1e3:g} mm  {'ok' if good else 'MISSED'}",
        flush=True,
    )
    return good


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100, help="of each kind")
    parser.add_argument("--seed", type=int, default=41)
    parser.add_argument("--only", default="", help="kinds of finding, by commas")
    asked = parser.parse_args()
    only = asked.only.split(",") if asked.only else sorted({by for by, _ in KINDS})
    results = [told(by, contact, asked.count, asked.seed) for by, contact in KINDS if by in only]
    sys.exit(0 if all(results) else 1)


if __name__ == "__main__":
    main()
