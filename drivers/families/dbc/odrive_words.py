"""What an ODrive's heartbeat says, in the words of its manual: axis errors, axis states and procedure results."""

from typing import Final

IDLE, CLOSED_LOOP = 1, 8
SUCCESS: Final = 0
_STATES: Final = {1: "IDLE", 3: "FULL_CALIBRATION_SEQUENCE", 8: "CLOSED_LOOP_CONTROL", 9: "LOCKIN_SPIN", 11: "HOMING"}
_RESULTS: Final = (
    "SUCCESS", "BUSY", "CANCELLED", "DISARMED", "NO_RESPONSE", "POLE_PAIR_CPR_MISMATCH",
    "PHASE_RESISTANCE_OUT_OF_RANGE", "PHASE_INDUCTANCE_OUT_OF_RANGE", "UNBALANCED_PHASES", "INVALID_MOTOR_TYPE",
    "ILLEGAL_HALL_STATE", "TIMEOUT", "HOMING_WITHOUT_ENDSTOP", "INVALID_STATE", "NOT_CALIBRATED", "NOT_CONVERGING",
)  # fmt: skip
_ERRORS: Final = {
    0: "INITIALIZING", 1: "SYSTEM_LEVEL", 2: "TIMING_ERROR", 3: "MISSING_ESTIMATE", 4: "BAD_CONFIG", 5: "DRV_FAULT",
    6: "MISSING_INPUT", 8: "DC_BUS_OVER_VOLTAGE", 9: "DC_BUS_UNDER_VOLTAGE", 10: "DC_BUS_OVER_CURRENT",
    11: "DC_BUS_OVER_REGEN_CURRENT", 12: "CURRENT_LIMIT_VIOLATION", 13: "MOTOR_OVER_TEMP", 14: "INVERTER_OVER_TEMP",
    15: "VELOCITY_LIMIT_VIOLATION", 16: "POSITION_LIMIT_VIOLATION", 24: "WATCHDOG_TIMER_EXPIRED",
    25: "ESTOP_REQUESTED", 26: "SPINOUT_DETECTED", 27: "BRAKE_RESISTOR_DISARMED", 28: "THERMISTOR_DISCONNECTED",
    30: "CALIBRATION_ERROR",
}  # fmt: skip


def told_words(error: int, state: int, result: int) -> str:
    """A heartbeat for people: raw values, each with its name where the manual has one."""
    bits = [_ERRORS.get(bit, f"bit {bit}") for bit in range(32) if error >> bit & 1]
    told = [f"axis error {error:#x} ({', '.join(bits)})"] if bits else []
    outcome = _RESULTS[result] if result < len(_RESULTS) else "unknown"
    return ", ".join(
        [*told, f"axis state {state} ({_STATES.get(state, 'another')})", f"procedure result {result} ({outcome})"]
    )
