"""Reference runs: hashes of what the code does, kept in tests/reference/trace_hashes.json and replayed by CI.

    python -m tests.support.reference [PART]

renews all of it, or that part: traces, campaigns, laws, plants, drives, conversations, trajectories, checks,
stories, refusals.

For a new law renew `traces` (a minute) and `laws`, for a new trial `campaigns` (some minutes), for a new effect of the
plant `plants`, and all after a change that is meant to change what runs do.

`traces`: trace_sha256 of `hil sim` (every frame received and sent, with its virtual time) for both ideal rigs with
every law, and for the microscope as it is shipped.
The other parts have files and modules of their own beside this one.
`campaigns`: SHA-256 over what every cell of the fault campaign found, for the shipped rigs on their own layouts.
"""

import argparse
import hashlib
import json
import os
from collections.abc import Callable, Sequence
from typing import Any

from tests.support.paths import RIGS, ROOT

FILE = ROOT / "tests" / "reference" / "trace_hashes.json"
SECONDS = 4.0
LEARNING = (
    "pd-feedforward",
    "structured-kalman",
    "presliding-kalman",
)  # laws also run inside iterative learning, on a figure that repeats
REPEATS = ["task.frequency_hz=10.0", "task.radius=1e-3", "task.approach_s=0.1", "plant.coulomb=[2.0, 0.3]"]
IDEAL_RIGS = ("microscope-ideal", "paper")
CAMPAIGNS = ("microscope", "paper")
CELL = (
    "rig", "layout", "checkpoint", "trial", "axis", "passed", "fault", "reaction", "detection_ticks",
    "peak_force_after", "end",
)  # fmt: skip


def runs() -> dict[str, tuple[str, list[str]]]:
    """Rig and overrides of every reference run, by name."""
    from hil.rig.law_names import LAWS

    plain = {f"{rig}, {law}": (rig, [f"law.name={law}"]) for rig in IDEAL_RIGS for law in LAWS}
    learning = {
        f"paper, {law}, learning": ("paper", [f"law.name={law}", "law.iterative_learning=true", *REPEATS])
        for law in LEARNING
    }
    return {**plain, **learning, "microscope": ("microscope", [])}


def trace_hash(rig: str, overrides: Sequence[str]) -> str:
    """trace_sha256 of `hil sim` over SECONDS."""
    from hil.rig.file import load_rig
    from hil.virtual.sim import simulate

    report, _ = simulate(load_rig(RIGS / f"{rig}.toml", overrides), RIGS, SECONDS)
    return report.trace_sha256


def campaign_hash(cells: Sequence[Any]) -> str:
    """Of the cells of a campaign, whatever its texts for people say."""
    found = [[getattr(cell, key) for key in CELL] for cell in cells]
    return hashlib.sha256(json.dumps(found).encode()).hexdigest()


def campaign(rig: str) -> dict[str, Any]:
    """Number of cells and their hash, of the whole campaign on a rig's own layout. Raises AssertionError where one of
    them does not pass.
    """
    from hil.studies.fault_campaign.campaign import campaign as run_campaign

    cells = run_campaign([RIGS / f"{rig}.toml"], 1, os.cpu_count() or 1, lambda done, total: None)
    failed = [f"{cell.checkpoint} / {cell.trial} / {cell.axis}: {cell.why}" for cell in cells if not cell.passed]
    assert not failed, "\n".join(failed)
    return {"cells": len(cells), "sha256": campaign_hash(cells)}


def known() -> dict[str, Any]:
    """The file's content."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


HALVES: dict[str, Callable[[], dict[str, Any]]] = {
    "traces": lambda: {name: trace_hash(*run) for name, run in runs().items()},
    "campaigns": lambda: {rig: campaign(rig) for rig in CAMPAIGNS},
}


def main() -> None:
    """Write a part anew, or all."""
    from tests.support import (
        check_reference,
        conversation_reference,
        drive_plan_reference,
        law_reference,
        plant_reference,
        refusal_reference,
        story_reference,
        trajectory_reference,
    )

    others = {
        "laws": law_reference.renew,
        "plants": plant_reference.renew,
        "drives": drive_plan_reference.renew,
        "conversations": conversation_reference.renew,
        "trajectories": trajectory_reference.renew,
        "checks": check_reference.renew,
        "stories": story_reference.renew,
        "refusals": refusal_reference.renew,
    }
    parser = argparse.ArgumentParser(prog="python -m tests.support.reference")
    parser.add_argument("part", nargs="?", choices=[*HALVES, *others], help="without it: all")
    asked = parser.parse_args().part
    for name, renew in others.items():
        if asked in (None, name):
            renew()
    if asked in others:
        return
    renewed = {name: make() for name, make in HALVES.items() if asked in (None, name)}
    document = known() | {"seconds": SECONDS} | renewed
    FILE.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
