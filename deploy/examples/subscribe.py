"""Print a rig's positions ten times a second: python subscribe.py [tcp/127.0.0.1:7447]."""

import contextlib
import json
import signal
import sys

import zenoh

from hil.telemetry.telemetry_pb2 import Status

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start with it ignored
endpoints = sys.argv[1:] or ["tcp/127.0.0.1:7447"]
config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": endpoints}}))
with zenoh.open(config) as session, contextlib.suppress(KeyboardInterrupt):
    samples = session.declare_subscriber("hil/*/status", zenoh.handlers.RingChannel(3))
    for sample in samples:
        status = Status.FromString(sample.payload.to_bytes())
        positions = zip(status.axes, status.position, strict=False)
        print(status.state, *(f"{axis}={position:.9f}" for axis, position in positions), flush=True)
