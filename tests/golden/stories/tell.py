"""What happens on a rig while it is disturbed: faults of the scenario language, lost ticks and an operator's orders.

A story's name is all it is drawn from: the rig, and the kinds of fault. A new kind belongs to no story until one names
it, so that it moves none.
"""

from collections.abc import Sequence
from random import Random
from typing import Any

import numpy as np

from drivers.frame import Frame
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, CycleResult, Tick
from hil.events.event import Event
from hil.events.sources import CycleEvents
from hil.events.stream import EventStream
from hil.events.table import Kind
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from sim_plant.config import PlantError
from sim_plant.scenario.language import KINDS, FaultConfig, Scenario
from tests.golden.golden import sha256
from tests.support.paths import RIGS
from tests.support.records import kept, table

TICKS = 400
RIGS_OF_STORIES: dict[str, tuple[str, list[str]]] = {
    "paper": ("paper", []),
    "paper heartbeat": (
        "paper",
        ["safety.heartbeat_s=0.1", "axes.x.push={force=1.6, distance=1e-3}", "axes.y.direction=-1"],
    ),
    "microscope": ("microscope-ideal", []),
    "microscope classic": ("microscope-ideal", ["bus.protocol=stage_classic"]),
}
STORIES = """
paper: wire_reorder, plant_torque_noise
paper: wire_alter, plant_encoder_latency, wire_babble
paper: plant_encoder_noise, plant_cable_hysteresis
paper: encoder_stuck
paper: plant_cogging, clock_jump
paper: wire_corrupt, encoder_glitch, bad_checksum
paper: drive_fault, plant_mode_frequency
paper: plant_cogging_period, wire_drop
paper: plant_mode_damping, plant_cable_reach
paper: encoder_fault
paper: plant_vibration_frequency, encoder_silent
paper: duplicate_feedback, plant_friction_variation
paper: drive_watchdog
paper: encoder_extreme, plant_friction_period
paper: plant_vibration
paper heartbeat: stale_feedback, wire_duplicate
paper heartbeat: plant_friction_phase, encoder_jump
paper heartbeat: encoder_noise, plant_presliding
paper heartbeat: plant_torque_lag, reordered_feedback, wire_down
paper heartbeat: push, wire_delay
paper heartbeat: torque_constant, plant_encoder_period
paper heartbeat: plant_cogging_phase, plant_presliding_damping, plant_drift
paper heartbeat: garbage, axis_jam, plant_mode_load
paper heartbeat: plant_cable_stiffness, wrong_sequence
paper heartbeat: plant_backlash
paper heartbeat: wire_bus_off, plant_bias
paper heartbeat: plant_encoder_periodic_error
paper heartbeat: plant_bias_walk, wire_no_ack
paper heartbeat: encoder_stuck, plant_bias, wire_alter
paper heartbeat: plant_friction_variation
microscope: plant_mode_frequency, plant_mode_damping
microscope: plant_vibration, encoder_silent
microscope: plant_friction_phase, encoder_jump
microscope: garbage, plant_backlash, stale_feedback
microscope: drive_fault, clock_jump, plant_cogging
microscope: plant_torque_noise, plant_cable_stiffness
microscope: plant_vibration_frequency
microscope: plant_cable_hysteresis
microscope: torque_constant, plant_encoder_period, encoder_fault
microscope: wire_bus_off, plant_friction_period
microscope: wrong_sequence, wire_babble
microscope: duplicate_feedback, wire_drop
microscope: wire_delay, bad_checksum
microscope: plant_cable_reach, plant_presliding, plant_encoder_latency
microscope: encoder_noise
microscope classic: wire_corrupt, drive_watchdog
microscope classic: axis_jam, wire_no_ack, wire_down
microscope classic: plant_bias_walk, encoder_extreme
microscope classic: plant_presliding_damping, plant_cogging_phase
microscope classic: wire_duplicate
microscope classic: plant_torque_lag, plant_encoder_periodic_error, plant_encoder_noise
microscope classic: reordered_feedback, plant_cogging_period
microscope classic: wire_reorder, push
microscope classic: plant_drift, plant_mode_load, encoder_glitch
microscope classic: plant_cable_hysteresis, plant_cogging
microscope classic: plant_cogging_phase, plant_encoder_latency
microscope classic: wire_duplicate, plant_presliding_damping
microscope classic: plant_cogging_period, axis_jam
microscope classic: push, wire_delay, plant_mode_load
microscope classic: wrong_sequence, drive_fault
"""
ORDERS = ("ACTIVATE", "STOP", "RESET", "ESTOP", "HOME", "SHUTDOWN", "HEARTBEAT", "LOAD_TASK")
GRANTS = ("recorder_ok", "realtime_ok", "rig_ok")
# What the hash of the records covers. A field that a record gains joins when stories are redrawn.
FIELDS = (
    "index", "scheduled_ns", "now_ns", "state", "fault", "faults_active", "flags", "sequence", "task_ns", "position",
    "position_estimate", "velocity_estimate", "disturbance_estimate", "innovation", "setpoint_position",
    "setpoint_velocity", "following_error", "force_requested", "force", "stamp_ns", "age_ticks", "drive_status", "port",
    "rejects", "samples_lost", "missed_own", "missed_host", "longest_streak", "illegal_events", "commands_refused",
    "law_floors", "evidence_total", "saturations", "cpu_ns", "run_delay_ns", "n_commands", "n_received", "n_sent",
    "n_evidence", "commands", "evidence_of", "evidence_value", "evidence_limit",
)  # fmt: skip


def stories() -> list[str]:
    """Their names."""
    return STORIES.strip().splitlines()


def tell(story: str) -> list[str]:
    """What was brought about, what was told of it, and how it ended."""
    return tell_and_latched(story)[0]


def tell_and_latched(story: str) -> tuple[list[str], set[Fault]]:
    """The lines of a story, and the faults that latched in it."""
    base, _, kinds = story.partition(": ")
    name, overrides = RIGS_OF_STORIES[base]
    rig = load_rig(RIGS / f"{name}.toml", overrides)
    draw = Random(story)
    faults = [
        _fault(Random(f"{story} {number}"), kind, rig.axis_names) for number, kind in enumerate(kinds.split(", "))
    ]
    orders = {draw.randrange(TICKS): CommandKind[draw.choice(ORDERS)] for _ in range(5)}
    axes = [(axis, config.kind) for axis, config in rig.axes.items()]
    stream = CycleEvents(EventStream(axes, rig.period_ns), rig.period_ns)
    told, records, latched, held_up = list[Event](), list[np.void](), set[Fault](), list[str]()

    def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        """Resets what latched after a while, and activates what is ready."""
        asked = [orders[index]] if index in orders else []
        if run.cycle.state is State.READY:
            asked.append(CommandKind.ACTIVATE)
        elif index % 50 == 49:
            asked.append(CommandKind.RESET)
        return [*asked, CommandKind.HEARTBEAT] if index % 30 == 0 else asked

    def observe(tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        records.append(kept(result.record))
        told.extend(stream.observe(run.cycle, result.record))
        latched.add(run.cycle.fault)

    scenario = Scenario(fault=[FaultConfig.model_validate(fault) for fault in faults])
    run = LockstepRun(rig, RIGS, operator=operator, observer=observe, scenario=scenario)
    for index in range(TICKS):
        if draw.randrange(97) == 0:
            slots = draw.choice((1, 2, 5, 30))
            held_up.append(f"{slots} before tick {run.index + slots}")
            run.skip(slots)
        if index == TICKS // 2:
            denied = draw.choice(GRANTS)
            held_up.append(f"{denied} denied from tick {run.index}")
            run.grants[denied] = False
        try:
            run.tick()
        except PlantError as error:  # the fault is more than can be integrated
            held_up.append(f"the emulator stops: {error}")
            break
    told.extend(stream.close())
    lines = [
        f"rig: {name}.toml" + "".join(f" {key}" for key in overrides),
        *(f"fault: {_words(fault)}" for fault in faults),
        "orders: " + ", ".join(f"{order.name} at tick {tick}" for tick, order in sorted(orders.items())),
        f"ticks lost: {', '.join(held_up) or 'none'}",
        *map(_line, told),
        *_ends(table(records), rig.axis_names),
        f"sha256 of all frames: {run.trace_sha256[:16]}",
    ]
    return lines, latched - {Fault.NONE}


def _fault(draw: Random, name: str, axes: Sequence[str]) -> dict[str, Any]:
    kind = KINDS[name]
    table: dict[str, Any] = {
        "kind": name,
        "at_tick": draw.randrange(20, TICKS),
        "duration_ticks": draw.randrange(1, 40),
    }
    if kind.unit:
        values = (kind.low, kind.high, 1.0, 1e-4, 1e-2, 3.0)
        table["value"] = draw.choice([value for value in values if kind.low <= value <= kind.high])
    if name.startswith("wire_"):
        return table | {"node": draw.choice([*axes, "host"]), "count": draw.randrange(20)}
    return table | ({"axis": draw.choice(axes)} if draw.randrange(4) else {})


def _words(fault: dict[str, Any]) -> str:
    unit = f" {KINDS[fault['kind']].unit}" if "value" in fault else ""
    more = [f"{key} {fault[key]}" for key in ("axis", "node", "count", "value") if key in fault]
    begins, lasts = fault["at_tick"], fault["duration_ticks"]
    return f"{fault['kind']} at tick {begins} for {lasts}: {', '.join(more) or 'every axis'}{unit}"


def _line(event: Event) -> str:
    cause = f" ({event.cause})" if event.kind is Kind.STATE else ""
    return f"tick {event.tick}: {event.text}{cause}"


def _ends(records: np.ndarray[Any, Any], axes: Sequence[str]) -> list[str]:
    last = records[-1]
    lines = [f"ends in {State(int(last['state'])).name}, fault {Fault(int(last['fault'])).name}"]
    for at, axis in enumerate(axes):
        force, error = (float(np.abs(records[key][:, at]).max()) for key in ("force", "following_error"))
        lines.append(
            f"axis {axis}: position {last['position'][at]:.6g}, most force {force:.6g}, most following error"
            f" {error:.6g} (SI units), {int(last['saturations'][at])} ticks saturated"
        )
    counts = ", ".join(f"{key} {int(last[key])}" for key in ("samples_lost", "missed_own", "missed_host"))
    hashed = sha256(*(np.ascontiguousarray(records[field]).tobytes() for field in FIELDS))
    return [*lines, counts, f"sha256 of all records: {hashed}"]
