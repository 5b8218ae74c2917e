"""What became of each attack on the code before it was written (the last commit without Unix socket and stop page).

failed: the attack succeeded. held: it did not. new: there was nothing of the kind to attack (a Unix socket, TLS, a stop
page). untried: nobody knows, and why. Tried on that code, unless the text begins with "by its code" or "reported".
"""

from typing import Literal, NamedTuple

Fate = Literal["failed", "held", "new", "untried"]


class Before(NamedTuple):
    """For every attack whose name begins so, the longest beginning counting."""

    attack: str
    fate: Fate
    seen: str


_ACCESS = "by its code: whoever connected could publish, declare queryables and show himself alive"
_SOCKET = "commands were Zenoh queries with a token; there was no such socket"
_TLS = "there were no commands over TLS"
_ZENOH_TLS = "there was no TLS"
_PAGE = "there was no stop page and no hil estop"
_GOALS = "there were no goals: a running rig could not be moved"
_CAMPAIGN = "control processes were killed and stopped at 200 random moments and held; the others were not tried"

BEFORE = (
    Before("queryable that", "failed", "estop expired, the rig stayed ACTIVE, and the token was handed over"),
    Before("spoofed status", "failed", "the spoofed status was heard"),
    Before("spoofed telemetry", "failed", _ACCESS),
    Before("spoofed liveliness", "failed", "hil/evil/alive was alive beside the sidecar"),
    Before("spoofed end", "untried", "needs an id that the session draws by chance"),
    Before("100 000 messages", "untried", "by its code there was no bound, and stop went the same way"),
    Before("100 000 damaged", "untried", "by its code there was no bound, and stop went the same way"),
    Before("20 MB payloads", "untried", "by its code there was no bound, and stop went the same way"),
    Before("10 000 queries", "untried", "by its code there was no bound, and stop went the same way"),
    Before("2000 idle connections", "untried", "by its code there was no bound on connections"),
    Before("2000 idle connections to the TLS port", "new", _TLS),
    Before("Zenoh over TLS", "new", _ZENOH_TLS),
    Before("another network namespace", "held", "by its code: the endpoint was on loopback then too"),
    Before("the old command key", "failed", "it was the way to command, open to be held or answered by others"),
    Before("another user connects", "new", _SOCKET),
    Before("another user opens", "held", "by its code: the runtime directory was private then too"),
    Before("another user presses", "new", _PAGE),
    Before("300 ", "new", _SOCKET),
    Before("a message of 64 KiB", "new", _SOCKET),
    Before("a request replayed", "held", "by its code: sequence numbers were checked"),
    Before("a request from the past", "held", "by its code: the expiry was checked"),
    Before("a request that never expires", "held", "by its code: the expiry was bounded"),
    Before("an unknown command", "held", "by its code: the kind was checked"),
    Before("swapped socket", "new", _SOCKET),
    Before("hung sidecar", "failed", "by its code: stop went through the sidecar alone"),
    Before("TLS without", "new", _TLS),
    Before("a monitor's certificate", "new", _TLS),
    Before("an operator", "new", _TLS),
    Before("a request recorded", "new", _TLS),
    Before("a nonce", "new", _TLS),
    Before("a STOP made", "new", _TLS),
    Before("an impostor", "new", _TLS),
    Before("another user opens the goal page", "new", _GOALS),
    Before("100 000 goals", "new", _GOALS),
    Before("goals ", "new", _GOALS),
    Before("random bytes all over the goal page", "new", _GOALS),
    Before("two ", "new", _GOALS),
    Before("a client that jogs", "new", _GOALS),
    Before("a flood of goals", "new", _GOALS),
    Before("a second control process", "failed", "reported: refused after it had claimed the core: OVERRUN_LONG"),
    Before("a second emulator", "failed", "it ran beside the first"),
    Before("a second sidecar", "held", "by its code: its endpoint was taken"),
    Before("foreign runtime directory, made", "failed", "root used another user's directory"),
    Before("foreign runtime directory with", "new", _PAGE),
    Before("planted symlink for the runtime", "held", "is not a directory"),
    Before("planted symlink for the stop", "new", _PAGE),
    Before("a pipe", "new", _PAGE),
    Before("full runtime directory", "failed", "an error without the path"),
    Before("ESC in the name", "new", _PAGE),
    Before("rig file deleted", "failed", "no stop: exit status 78"),
    Before("no network", "failed", "by its code: stop went over TCP on the loopback interface"),
    Before("control process hangs", "untried", "it was not tried there"),
    Before("sidecar killed", "failed", "no stop: exit status 69; reported: the next began with a state 3.6 s old"),
    Before("sidecar killed in", "untried", _CAMPAIGN),
    Before("runtime directory deleted", "untried", "a sidecar with its files open could still have told it"),
    Before("control process at its memory limit", "untried", _CAMPAIGN),
    Before("control killed", "held", _CAMPAIGN),
    Before("control stopped", "held", _CAMPAIGN),
    Before("sidecar ", "untried", _CAMPAIGN),
    Before("emulator ", "untried", _CAMPAIGN),
    Before("router ", "untried", _CAMPAIGN),
)  # fmt: skip


def before(attack: str) -> Before:
    """What became of an attack, or of pressing stop during it. Raises LookupError for one that is not listed."""
    name = attack.removeprefix("stop pressed during: ")
    fitting = [entry for entry in BEFORE if name.startswith(entry.attack)]
    if not fitting:
        raise LookupError(f"attack {name!r}: say in tests/attacks/before.py what the code before made of it")
    return max(fitting, key=lambda entry: len(entry.attack))
