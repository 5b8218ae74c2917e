"""A Zenoh router between a rig's sidecar and many monitors, where no zenohd is to be had. Mutual TLS only.

python deploy/zenoh/router.py SIDECAR LISTEN CREDENTIALS
    SIDECAR      tls/rig-pc:7447, as in the rig file's [telemetry] listen
    LISTEN       tls/0.0.0.0:7447
    CREDENTIALS  the router's directory (make-certificates.sh)
"""

import signal
import sys
from pathlib import Path

import zenoh

from hil.telemetry.credentials import Credentials
from hil.telemetry.session import router_config


def main(sidecar: str, listen: str, credentials: str) -> None:
    """Route until SIGTERM or SIGINT."""
    signals = {signal.SIGTERM, signal.SIGINT}
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)  # before Zenoh's threads start
    with zenoh.open(router_config([listen], sidecar, Credentials(Path(credentials)))):
        print(f"routing between {sidecar} and {listen}", flush=True)
        signal.sigwait(signals)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
