"""Trials that follow from a fault's row alone: where it counts, it must latch in time and with the row's reaction.

What the row says of states and reaction stands a second time in tests/cycle/test_fault_thresholds.py.
"""

from collections.abc import Callable, Iterator

from drivers.protocols.base import INPUTS, DriveStatus
from hil.cycle.fault_table import ROWS, Fault, Row
from hil.studies.fault_campaign.injections import Encoder, encoder_creep, fail, foreign_command, stamp_off, status_bit
from hil.studies.fault_campaign.layout_capabilities import NONE, Capability
from hil.studies.fault_campaign.trial import ALWAYS, MOVING, Step, Trial, once

STEPS: dict[str, Callable[[str], Step]] = {
    "foreign_command": lambda _: once(foreign_command),
    "encoder_jump": lambda _: Encoder(lambda count, held, k: count + 10**7),
    "encoder_noise": lambda _: Encoder(lambda count, held, k: count + (-1) ** k * 10**7),
    "encoder_creep": lambda _: once(encoder_creep),
    "fail": lambda _: once(fail),
    "stamp": lambda ns: stamp_off(int(ns)),
    "status_bit": lambda bit: status_bit(DriveStatus[bit]),
}


def trials_of(fault: Fault, row: Row) -> Iterator[Trial]:
    """Those that the row makes."""
    for declared in row.trials:
        if declared.step:
            name, _, argument = declared.step.partition(" ")
            yield Trial(
                declared.name,
                STEPS[name](argument),
                (fault,),
                within=declared.within,
                armed=row.states & ALWAYS,
                resting_only=row.states.isdisjoint(MOVING),
                demand=row.reaction,
                inputs=name == "status_bit" and bool(DriveStatus[argument] & INPUTS),
                only=Capability.STAMPS if name == "stamp" else NONE,
                needs=Capability.STATE if row.told_by_drives else NONE,
            )


MADE: dict[str, Trial] = {trial.name: trial for fault, row in ROWS.items() for trial in trials_of(fault, row)}
