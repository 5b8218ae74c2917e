"""A motor by itself, with the ideal loops of its drive: what the emulated drive has behind it where there is no stage.

Rules. Positions in counts, speeds in counts/s. Under torque it is a mass with viscous friction, solved exactly over
each interval; under a loop of the drive's own it follows without error, as far as the profile's speed and acceleration
allow. Nothing is drawn at random.
"""

from math import copysign, exp, inf, sqrt


class Motor:
    """position: counts. velocity: counts/s. time_ns: until when it has been followed.

    inertia: kg m^2 (kg). friction: N m s/rad (N s/m), viscous, > 0. resolution: rad (m) per count.
    """

    def __init__(self, inertia: float, friction: float, resolution: float, start_ns: int) -> None:
        self.position = 0.0
        self.velocity = 0.0
        self.time_ns = start_ns
        self._rate = friction / inertia
        self._per_torque = 1.0 / (friction * resolution)  # counts/s, in the end, per N m

    def _pass(self, now_ns: int) -> float:
        """Seconds until then."""
        elapsed, self.time_ns = max(0, now_ns - self.time_ns), max(self.time_ns, now_ns)
        return elapsed * 1e-9

    def push(self, torque: float, now_ns: int) -> None:
        """Let torque (N m) act until then; zero: it runs out."""
        seconds = self._pass(now_ns)
        final = torque * self._per_torque
        decay = exp(-self._rate * seconds)
        self.position += final * seconds + (self.velocity - final) * (1.0 - decay) / self._rate
        self.velocity = final + (self.velocity - final) * decay

    def hold(self, now_ns: int) -> None:
        """It stands still."""
        self._pass(now_ns)
        self.velocity = 0.0

    def run(self, target: float, acceleration: float, now_ns: int) -> None:
        """Approach a speed (counts/s) with an acceleration (counts/s^2; inf: at once), then keep it."""
        seconds = self._pass(now_ns)
        change = target - self.velocity
        ramp = min(seconds, abs(change) / acceleration)
        before = self.velocity
        self.velocity = (
            target if ramp < seconds or acceleration == inf else before + copysign(acceleration * ramp, change)
        )
        self.position += 0.5 * (before + self.velocity) * ramp + self.velocity * (seconds - ramp)

    def go(self, target: float, speed: float, acceleration: float, now_ns: int) -> None:
        """Approach a position with a trapezoidal profile, in steps of a millisecond; it stands there in the end."""
        while self.time_ns < now_ns:
            step_ns = min(now_ns, self.time_ns + 1_000_000)
            seconds = (step_ns - self.time_ns) * 1e-9
            left = target - self.position
            brakes = sqrt(2.0 * acceleration * abs(left)) if acceleration < inf else inf
            wanted = min(speed, brakes, abs(left) / seconds)
            if abs(left) <= wanted * seconds and abs(self.velocity) <= wanted + acceleration * seconds:
                self._pass(step_ns)
                self.position, self.velocity = target, 0.0
            else:
                self.run(copysign(wanted, left), acceleration, step_ns)

    def reach(self, target: float, at_ns: int, now_ns: int) -> None:
        """Move evenly, so as to be at a position at an instant."""
        left_s = (at_ns - self.time_ns) * 1e-9
        seconds = self._pass(min(now_ns, at_ns))
        if left_s > 0:
            self.velocity = (target - self.position) / left_s
            self.position += self.velocity * seconds
        if now_ns >= at_ns:
            self.position = target
            self.hold(now_ns)
