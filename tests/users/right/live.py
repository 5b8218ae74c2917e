"""A live rig: watched, commanded, its telemetry read in batches."""

import itertools

import hil


def main() -> None:
    """Watch a second, then activate."""
    try:
        with hil.connect("paper") as rig:
            for columns in itertools.islice(rig.telemetry(), 10):
                print(columns["position"][-1])
            verdict = rig.command("activate")
            print(verdict.accepted, verdict.reason, verdict.state)
            for event in rig.log():
                print(event.line)
    except (hil.NoSidecarError, hil.NoGatewayError) as error:
        print(error)
