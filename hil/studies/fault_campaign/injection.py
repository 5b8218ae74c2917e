"""The injection under faults and stops: every anomaly of a cell, each phase that it comes to, all that may happen.

Demanded of each:
- A pulse goes into a pierced cell or nowhere, and none outlives its phase.
- Under WITHDRAW the tip goes no deeper, is at its safe height within OUT_S of what happened, and stays there.
- Where the tip stays, it comes to rest, and the words say so.
"""

import functools
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.control.motion.injection.verdict import Phase
from hil.cycle.decided_motion import DecidedMotion
from hil.cycle.fault_monitor import REACTIONS
from hil.cycle.fault_table import Fault, Reaction
from hil.cycle.state_machine import TORQUE_STATES, State
from hil.cycle.tick import CommandKind
from hil.rig.bus_load import rig_layout
from hil.rig.file import load_rig
from hil.rig.provenance import referenced_files, unpacked_rig
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.campaign import over_processes
from hil.studies.fault_campaign.checkpoints import CampaignRun
from hil.studies.fault_campaign.happenings import HAPPENINGS, Happening
from hil.studies.fault_campaign.matrix import Cell, in_fork
from hil.studies.inject.equipment import has_equipment, middle, words
from sim_plant.dish_config import DRAWN

OUT_S = 0.5  # from what happened to the tip at its safe height
REST_S = 0.1  # watched behind that, or behind the end of the torque
INTO = 3  # ticks into a phase
DEEPER = 6e-5  # m that the tip may go on: at 4 mm/s, what a detection takes that needs 8 readings
LONGEST_S = 6.0  # of one cell, the way to it included
GOOD = "good cell"
ANOMALIES = (GOOD, *DRAWN)


def with_cell(path: Path, anomalies: Sequence[str], overrides: Sequence[str] = ()) -> list[RigConfig]:
    """The rig with one cell of each of these kinds under its tip, and with the reference equipment where it has none of
    its own. Raises RigError.
    """
    rig = load_rig(path, overrides)
    spot = tuple(rig.motion.parameters["cells"][0][:2]) if has_equipment(rig) else middle(rig)
    fd = rig_layout(rig, path.parent).fd
    kinds = [[] if anomaly == GOOD else [anomaly] for anomaly in anomalies]
    return [load_rig(path, (*overrides, *words(rig, [spot], 1, 0.0, kind, fd=fd))) for kind in kinds]


@dataclass(frozen=True)
class InjectionChunk:
    """Work for one process: a rig with one cell (as a document, so that it travels), and which happenings to try."""

    document: str
    files: dict[str, str]
    anomaly: str
    stride: int
    only: str


def plan(
    paths: Sequence[Path], *, stride: int = 1, only: str = "", overrides: Sequence[str] = ()
) -> list[InjectionChunk]:
    """A chunk for each rig and anomaly. stride: every n-th happening. only: what names of happenings contain."""
    chunks = []
    for path in paths:
        for anomaly, rig in zip(ANOMALIES, with_cell(path, ANOMALIES, overrides), strict=True):
            chunks.append(
                InjectionChunk(rig.model_dump_json(), referenced_files(rig, path.parent), anomaly, stride, only)
            )
    return chunks


def run_injection(chunk: InjectionChunk) -> list[Cell]:
    """One cell, from the way there to the lift; at the beginning of each phase all that may happen, each in a fork."""
    with unpacked_rig(chunk.document, chunk.files) as (rig, folder):
        run, cells = CampaignRun(rig, folder), []
        run.ready()
        run.asks = CommandKind.ACTIVATE
        run.follow()
        last, since, number = Phase.NONE, 0, ANOMALIES.index(chunk.anomaly)
        for _ in range(round(LONGEST_S * 1e9 / rig.period_ns)):
            run.tick()
            if not _decided(run).runs:
                break
            phase = _phase(run)
            since = since + 1 if phase is last else 0
            last = phase
            if phase is Phase.NONE or since != INTO:
                continue
            for happening in (one for one in HAPPENINGS if chunk.only in one.name):
                number += 1
                if number % chunk.stride == 0:
                    cells.append(in_fork(functools.partial(_tried, happening, chunk.anomaly, phase, run)))
        return cells


def injection_campaign(
    rigs: Sequence[Path],
    stride: int,
    jobs: int,
    done: Callable[[int, int], None],
    overrides: Sequence[str] = (),
    only: str = "",
    scheduler: str = "",
) -> list[Cell]:
    """All of it, as campaign.campaign does its own. done: called with dishes done, and all of them. Raises RigError."""
    work = plan(rigs, stride=stride, only=only, overrides=overrides)
    return over_processes(run_injection, work, [1] * len(work), jobs, done, scheduler)


def _decided(run: CampaignRun) -> DecidedMotion:
    decided = run.cycle.supervisor.goals.decided
    assert decided is not None
    return decided


def _phase(run: CampaignRun) -> Phase:
    phase = _decided(run).phase
    return Phase(phase) if phase in set(Phase) else Phase.NONE


class InjectionWatch:
    """What is seen of a run since something happened; ticks count from there, -1: never.

    inside: it was beyond its safe height. out: since when the tip is at its safe height. latched: when a fault did.
    still: since when no torque is permitted. deeper: m that it went further in, in a phase in the cell. led: it was led
    out.
    """

    def __init__(self, run: CampaignRun, phase: Phase) -> None:
        way_out = run.cycle.supervisor.way_out
        assert way_out is not None
        assert run.stage.dish is not None
        self._run, self._way_out, self._dish = run, way_out, run.stage.dish
        self._began = self._depth()
        self._deep = Phase.SEEK <= phase <= Phase.CONFIRM
        self.inside = way_out.needed(float(run.true_position[way_out.axis]), float(run.true_velocity[way_out.axis]))
        self.out = self.latched = self.still = -1
        self.deeper = self.peak = 0.0
        self.led = False

    def _depth(self) -> float:
        return self._dish.direction * float(self._run.true_position[self._way_out.axis])

    def look(self, k: int) -> None:
        """After tick `k`."""
        run = self._run
        beyond = self._way_out.beyond(float(run.true_position[self._way_out.axis]))
        self.out = -1 if beyond else k if self.out < 0 else self.out
        if self.latched < 0 and run.cycle.fault:
            self.latched = k
        if self.latched >= 0:
            self.peak = max(self.peak, *map(abs, run.stage.applied_force))
        if self.still < 0 and run.cycle.state not in TORQUE_STATES:
            self.still = k
        if self._deep:
            self.deeper = max(self.deeper, self._depth() - self._began)
        self.led = self.led or run.cycle.supervisor.released is not None

    @property
    def in_cell(self) -> bool:
        """Whether the tip is in a cell, by the dish."""
        return self._dish.entered is not None

    @property
    def wrong_pulses(self) -> int:
        """Into a cell that was whole, into none, or on while the tip left."""
        pulses = [pulse for cell in self._dish.cells for pulse in cell.pulses]
        return sum(not pulse.pierced for pulse in (*pulses, *self._dish.stray))


def failure(happening: Happening, run: CampaignRun, seen: InjectionWatch) -> str:
    """Why what followed is not what must; empty where it is."""
    state, fault, tip = run.cycle.state, run.cycle.fault, run.cycle.tip
    if seen.wrong_pulses:
        return f"{seen.wrong_pulses} pulses into what is not pierced"
    ends = happening.ends if seen.inside or not happening.held_outside else State.ACTIVE
    if state is not ends:
        return f"ended {state.name} with {fault.name}, expected {ends.name}"
    if fault not in (happening.faults or (Fault.NONE,)):
        return f"latched {fault.name}, expected {' or '.join(f.name for f in happening.faults) or 'none'}"
    if happening.clears:
        return "the tip is in a cell" if seen.in_cell else ""
    if happening.reaction is Reaction.WITHDRAW and seen.inside:
        return _stays_in(run, seen)
    if happening.reaction > Reaction.WITHDRAW:
        if (seen.out < 0 and not tip) or (seen.out >= 0 and tip and "last seen" not in tip):
            return f"the tip is {'beyond' if seen.out < 0 else 'at'} its safe height, and the words say {tip!r}"
        if seen.led:
            return f"it was led out, although {happening.reaction.name} is demanded"
    return ""


def _stays_in(run: CampaignRun, seen: InjectionWatch) -> str:
    most = round(OUT_S * 1e9 / run.rig.period_ns)
    if not 0 <= seen.out <= most:
        return f"at its safe height after {seen.out} ticks, allowed {most}"
    if seen.deeper > DEEPER:
        return f"it went on by {seen.deeper * 1e6:.0f} um, allowed {DEEPER * 1e6:.0f}"
    return f"out, and yet: {run.cycle.tip}" if run.cycle.tip else ""


def _tried(happening: Happening, anomaly: str, phase: Phase, run: CampaignRun) -> Cell:
    """Let it happen, and watch. The run is used up."""
    seen, why = InjectionWatch(run, phase), ""
    names = run.rig.axis_names
    along = run.cycle.supervisor.way_out.axis  # type: ignore[union-attr]
    axis = next(n for n in range(len(names)) if n != along) if happening.across else along
    run.asks = happening.command
    until, rest = round(OUT_S * 1e9 / run.rig.period_ns), round(REST_S * 1e9 / run.rig.period_ns)
    try:
        k = -1
        while (k := k + 1) <= until + rest and not 0 <= seen.still < k - rest:
            happening.step(run, axis, k)
            run.tick()
            seen.look(k)
        why = failure(happening, run, seen)
    except Exception:
        why = traceback.format_exc(limit=-3).strip().replace("\n", " | ")
    fault = run.cycle.fault
    led = seen.led and happening.reaction is Reaction.WITHDRAW
    reaction = Reaction.WITHDRAW if led else REACTIONS[fault]
    return Cell(
        rig=run.rig.name,
        layout=run.rig.bus.protocol,
        checkpoint=f"{anomaly}, {phase.name.lower()}",
        trial=f"injection: {happening.name}",
        axis="-",
        passed=not why,
        why=why,
        fault=fault.name.lower() if fault else "",
        reaction=reaction.name.lower() if fault or led else "",
        detection_ticks=seen.latched,
        peak_force_after=seen.peak,
        end=run.cycle.state.name,
        lacking="",
        out_ticks=seen.out if led else -1,
    )
