"""Drives on clocks of their own, for a day and around every wrap: no sample is refused, nothing is believed wrongly.

`day` takes samples through the drives' own codec, the host's layout, its clock and its filter. `around` runs the whole
cycle against the emulated stage, beginning just before a wrap of time stamp or sequence number.
"""

import math
from typing import NamedTuple

from drivers.families.stage.config import stage_keys
from drivers.protocols.base import DriveStatus, Sample
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from sim_plant.drives.stage import MADE
from tests.support.paths import RIGS

LAYOUTS = ("stage_fd", "stage_classic")
DRIFTS_PPM = (-500, -100, 100, 500)
SENT_NS, ANSWERED_NS = 150_000, 130_000  # from the tick's start to the sample, and from there to its arrival
JITTER_NS = 40_000
AMPLITUDE, OMEGA = 1e-3, 0.6  # m, rad/s: of the motion that is sampled
SPREAD_NS = SENT_NS + ANSWERED_NS  # that an instant may be off by: nobody tells where in the window a sample was
_ENABLED = int(DriveStatus.ENABLED)
BELOW_TICKS = 300  # in which the rig becomes ACTIVE before a wrap
WRAPS = {  # stage_classic's own, of 5 bits and 4 ms, come in every run
    "stamp, 32 bits": 1 << 32, "stamp, 31 bits": 1 << 31, "sequence, 16 bits": 1 << 16,
    "sequence, 32 bits": 1 << 32, "sequence, 53 bits": 1 << 53, "sequence, 63 bits": 1 << 63,
}  # fmt: skip


class Day(NamedTuple):
    """samples: taken. flagged: times that a fault was flagged. error: greatest, m, of the filter's position, behind the
    first minute. bound: what it may be: the speed times SPREAD_NS, and two counts.
    """

    samples: int
    flagged: int
    refused: int
    error: float
    bound: float

    @property
    def held(self) -> bool:
        """Nothing was refused or flagged, and the filter stayed with the axis."""
        return not self.flagged and not self.refused and self.error <= self.bound


def day(layout: str, ppm: int, rate_hz: float, hours: float) -> Day:
    """So many hours of one axis' samples; its clock runs by ppm too fast, from an offset that wraps early."""
    rig = load_rig(RIGS / "paper.toml", [f"bus.protocol={layout}", f"rate_hz={rate_hz:g}", "drives.watchdog_s=0.1",
                                         "law.name=pd-feedforward"])  # fmt: skip
    cycle = ControlCycle(rig, RIGS)
    keys = stage_keys(rig.bus)
    drives = MADE[layout](keys.host_id, keys.feedback_id, [axis.rated_force for axis in rig.axes.values()])
    clock, motion, monitor = cycle.sampling.clocks[0], cycle.filters[0], cycle.monitor
    inputs, period_ns = cycle.inputs[0], rig.period_ns
    resolution = rig.axes["x"].encoder_resolution
    ticks, settled = round(hours * 3600.0 * rate_hz), round(60.0 * rate_hz)
    offset, scale = (1 << 32) - 5 * period_ns, 1_000_000 + ppm
    flagged = refused = 0
    error = 0.0
    for tick in range(1, ticks + 1):
        begun = tick * period_ns
        true = begun + SENT_NS + tick * 7919 % JITTER_NS
        where = AMPLITUDE * math.sin(OMEGA * 1e-9 * true)
        stamp = offset + true * scale // 1_000_000
        frame = drives.encode_feedback(Sample(0, round(where / resolution), _ENABLED, tick, stamp))
        sample = cycle.protocol.decode(frame._replace(timestamp_ns=true + ANSWERED_NS))
        if not isinstance(sample, Sample):
            refused += 1
            continue
        monitor.begin()
        tracked = tick > 1
        if not clock.take(0, sample, begun, true + ANSWERED_NS, monitor, tracked=tracked):
            refused += 1
        flagged += monitor.active != 0
        if not tracked:
            motion.reseed(inputs.position)
        motion.correct(0.0, inputs.sample_interval, inputs.position, inputs.fresh, clock.stretch)
        if tick > settled:
            error = max(error, abs(motion.position - where))

    return Day(ticks, flagged, refused, error, AMPLITUDE * OMEGA * SPREAD_NS * 1e-9 + 2.0 * resolution)


class Around(NamedTuple):
    """ticks: run. active: in which the rig was ACTIVE. faults: that counted, by name."""

    ticks: int
    active: int
    faults: dict[str, int]

    @property
    def held(self) -> bool:
        """It became ACTIVE, stayed so, and no fault was counted."""
        return not self.faults and self.active >= self.ticks - BELOW_TICKS


def around(layout: str, wrap: str, ppm: int, ticks: int) -> Around:
    """The paper's rig at rest, its drives' clocks by ppm too fast, from just before a wrap on."""
    run = LockstepRun(load_rig(RIGS / "paper.toml", [f"bus.protocol={layout}", "task.kind=hold"]), RIGS)
    offset = 0
    if wrap.startswith("sequence"):
        run.cycle.sent_sequence = WRAPS[wrap] - BELOW_TICKS
    else:
        offset = WRAPS[wrap] - BELOW_TICKS * run.rig.period_ns

    def own_clock(sample: Sample) -> Sample:
        return Sample(
            sample.axis, sample.position, sample.status, sample.sequence,
            offset + sample.stamp_ns + sample.stamp_ns * ppm // 1_000_000,
        )  # fmt: skip

    for drive in run.stage.drives:
        drive.taps.append(own_clock)
    active = 0
    for _ in range(ticks):
        run.tick()
        active += run.cycle.state is State.ACTIVE
    counts = run.cycle.monitor.named_counts()
    faults = {name: count for name, count in counts.items() if count}
    if run.cycle.fault is not Fault.NONE:
        faults[run.cycle.fault.name] = 1
    return Around(ticks, active, faults)


def told_days(rate_hz: float, hours: float) -> bool:
    """Print a day of each layout and drift; whether all held."""
    found = True
    for layout in LAYOUTS:
        for ppm in DRIFTS_PPM:
            one = day(layout, ppm, rate_hz, hours)
            found &= one.held
            print(
                f"{'held' if one.held else 'FAILED'}: {layout}, {ppm} ppm, {one.samples} samples at {rate_hz:g} Hz: "
                f"{one.flagged} faults, {one.refused} refused, {one.error * 1e6:.3g} um of {one.bound * 1e6:.3g} um",
                flush=True,
            )
    return found


def told_wraps(ticks: int, wraps: tuple[str, ...] = tuple(WRAPS)) -> bool:
    """Print a run around each wrap, of each layout and drift; whether all held."""
    found = True
    for wrap in wraps:
        for layout in LAYOUTS:
            for ppm in DRIFTS_PPM:
                one = around(layout, wrap, ppm, ticks)
                found &= one.held
                told = f"{one.active} of {one.ticks} ticks ACTIVE, faults {one.faults or 0}"
                print(f"{'held' if one.held else 'FAILED'}: {wrap}, {layout}, {ppm} ppm: {told}", flush=True)
    return found
