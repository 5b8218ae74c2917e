"""What comes from sensors: silence, values that cannot be true, frames out of sequence."""

from typing import Final

from hil.cycle.faults.row import MOVING, OF_SENSOR, RESET, Reaction, Row, Trial

_CABLE: Final = f"check the sensor's supply, cable and identifier with hil bus, {RESET}"

ROWS: Final = (
    Row(
        44,
        "SENSOR_SILENT",
        requirement="SR-8.1",
        seen_by="no valid reading of a sensor",
        after="sensors.NAME.silent_ticks (3)",
        reaction=Reaction.STOP,
        states=MOVING,
        of_sensor=True,
        measured="no valid reading",
        unit="ticks",
        cause="sensor off, cable loose, bus overloaded, or the sensor calls its readings invalid",
        action=_CABLE,
        trials=(Trial("sensor silent"), Trial("sensor invalid"), Trial("sensor repeats a sequence number")),
    ),
    Row(
        45,
        "SENSOR_STUCK",
        requirement="SR-8.1",
        seen_by="a sensor repeats one value to the last digit",
        after="sensors.NAME.stuck_ticks (8)",
        reaction=Reaction.STOP,
        states=MOVING,
        of_sensor=True,
        measured="readings of one value in a row",
        unit="ticks",
        cause="the sensor's amplifier or converter hangs, or its input is saturated",
        action=f"switch the sensor off and on, {RESET}",
        trials=(Trial("sensor stuck"),),
    ),
    Row(
        46,
        "SENSOR_RANGE",
        requirement="SR-8.1",
        seen_by="a reading outside sensors.NAME.range",
        after="1 reading",
        reaction=Reaction.STOP,
        states=MOVING,
        of_sensor=True,
        measured="reading outside its range",
        unit=OF_SENSOR,
        cause="the sensor is overloaded or broken, or its scale or zero is not as stated",
        action=f"take the load off; check sensors.NAME.scale and range, {RESET}",
        trials=(Trial("sensor out of range"),),
    ),
    Row(
        47,
        "SENSOR_SEQUENCE",
        requirement="SR-8.1",
        seen_by="a sensor's sequence number does not follow; the reading is not used",
        after="1 frame",
        reaction=Reaction.COUNT,
        states=MOVING,
        of_sensor=True,
        measured="step of the sequence number",
        unit="1",
        cause="the sensor was restarted, or two nodes have its identifier",
        action="none, if it is rare; else look for a second node with hil bus",
        trials=(Trial("sensor skips sequence numbers"),),
    ),
)
