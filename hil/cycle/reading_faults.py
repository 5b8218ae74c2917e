"""The detectors of the sensors: silent, stuck, out of range, out of sequence."""

from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault
from hil.cycle.readings import Readings


def check_readings(readings: Readings, monitor: FaultMonitor) -> None:
    """Flag what is wrong with this tick's readings; evidence names the channel in the place of the axis."""
    if not readings.alarm:
        return
    for channel, age in enumerate(readings.age):
        silent, stuck = readings.silent_ticks[channel], readings.stuck_ticks[channel]
        if age >= silent:
            monitor.flag(Fault.SENSOR_SILENT, age, silent, channel)
        if 0 < stuck <= readings.repeats[channel]:
            monitor.flag(Fault.SENSOR_STUCK, readings.repeats[channel], stuck, channel)
        if readings.outside[channel]:
            value, low, high = readings.values[channel], readings.low[channel], readings.high[channel]
            monitor.flag(Fault.SENSOR_RANGE, value, low if value < low else high, channel)
        if readings.strayed[channel] >= 0:
            monitor.flag(Fault.SENSOR_SEQUENCE, readings.strayed[channel], 1, channel)
