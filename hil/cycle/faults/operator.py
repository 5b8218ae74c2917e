"""What the operator's side owes the loop: a heartbeat, and grants."""

from typing import Final

from hil.cycle.faults.row import ALWAYS, MOVING, RESET, Form, Reaction, Row, Trial

ROWS: Final = (
    Row(
        30,
        "HEARTBEAT_LOST",
        seen_by="age of the operator's heartbeat",
        after="safety.heartbeat_s, when not 0",
        reaction=Reaction.STOP,
        states=MOVING,
        measured="age of the operator's heartbeat",
        unit="s",
        cause="the operator's program ended or lost its connection",
        action=f"start it again, {RESET}",
    ),
    Row(
        31,
        "REALTIME_DENIED",
        seen_by="what the kernel granted",
        after="at start; ACTIVATE is refused unless timing.allow_degraded",
        reaction=Reaction.COUNT,
        states=ALWAYS,
        form=Form.GRANT,
        measured="real time is {}",
        words=("denied", "granted"),
        cause="the kernel refused what [timing] asks for",
        action="hil doctor says what to grant",
    ),
    Row(
        32,
        "RECORDER_LOST",
        seen_by="the sidecar's heartbeat",
        after="ACTIVATE is refused if telemetry.recording_required",
        reaction=Reaction.COUNT,
        states=ALWAYS,
        form=Form.GRANT,
        measured="the recorder is {}",
        words=("gone", "there"),
        cause="the sidecar is not running, or cannot write",
        action="start hil sidecar; look at its disk",
        trials=(Trial("recorder lost"),),
    ),
    Row(
        33,
        "RIG_CHANGED",
        seen_by="hash of the rig file",
        after="ACTIVATE is refused",
        reaction=Reaction.COUNT,
        states=ALWAYS,
        form=Form.GRANT,
        measured="the rig file is {}",
        words=("another than was read", "as it was read"),
        cause="somebody wrote the rig file, or a file it names",
        action="restart the control process to take the new file, or put the old one back",
        trials=(Trial("rig file changed"),),
    ),
)
