"""Whether a rig goes with the drives of its DBC file."""

from drivers.families import Circumstances
from drivers.families.dbc.config import DbcBinding, dbc_keys


def problems(rig: Circumstances) -> list[str]:
    """Positions that come too seldom for the axis' speed or the rig's rate, states that come too seldom, and VESCs that
    may have another timeout than the rig relies on.
    """
    binding = dbc_keys(rig.bus).dbc
    if binding is None:
        return []
    return [*_wrap_problems(binding, rig), *_period_problems(binding, rig), *_timeout_problems(binding, rig)]


def _wrap_problems(binding: DbcBinding, rig: Circumstances) -> list[str]:
    """An axis that turns by more than half a turn between two positions cannot be told from one that turns back."""
    period_s = max(binding.feedback_period_s, rig.period_s)
    axes = zip(binding.position, rig.speeds.items(), strict=False)
    wrapping = [(name, speed * period_s, item.wrap * rig.steps[name]) for item, (name, speed) in axes if item.wrap]
    return [
        f"bus.dbc.position: at axes.{name}.limits.speed the axis goes {way:g} in the "
        f"{period_s:g} s between two positions; it must be less than half of `wrap`, {turn / 2:g}"
        for name, way, turn in wrapping
        if way >= turn / 2
    ]


def _period_problems(binding: DbcBinding, rig: Circumstances) -> list[str]:
    problems = []
    if binding.feedback_period_s > 1.001 * rig.period_s:
        problems.append(
            f"bus.dbc.feedback_period_s = {binding.feedback_period_s:g}: a position has to come in every tick; "
            f"rate_hz = {rig.rate_hz:g} has to be {1 / binding.feedback_period_s:g} or less"
        )
    longest_s = rig.disable_ticks * rig.period_s
    apart = {item.message for item in binding.status} - {item.message for item in binding.position}
    if apart and binding.state_period_s >= longest_s:
        problems.append(
            f"bus.dbc.state_period_s = {binding.state_period_s:g}: a drive that is disabled has to say so within the "
            f"{longest_s:g} s of safety.disable_timeout_ticks = {rig.disable_ticks}"
        )
    return problems


def _timeout_problems(binding: DbcBinding, rig: Circumstances) -> list[str]:
    """A VESC's timeout is the rig's watchdog; 0 would be none."""
    longest_ms = rig.watchdog_s * 1e3
    return [
        f"bus.dbc.vesc.values[{at}]: timeout_msec may be {item.least:g} to {item.most:g}; the rig relies on "
        f"drives.watchdog_s = {rig.watchdog_s:g}, so it has to be above 0 and at most {longest_ms:g}"
        for at, item in enumerate(binding.vesc.values if binding.vesc else ())
        if item.value == "timeout_msec" and not (item.least > 0 and item.most <= longest_ms * (1 + 1e-9))
    ]
