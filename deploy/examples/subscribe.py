"""Print a rig's positions ten times a second: python subscribe.py [tcp/127.0.0.1:7447]."""

import contextlib
import json
import sys

import zenoh

from hil.telemetry.telemetry_pb2 import Status

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:] or ["tcp/127.0.0.1:7447"]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session, contextlib.suppress(KeyboardInterrupt):
    samples = session.declare_subscriber("hil/*/status", zenoh.handlers.RingChannel(3))
    for sample in samples:
        status = Status.FromString(sample.payload.to_bytes())
        positions = zip(status.axes, status.position, strict=False)
        print(status.state, *(f"{axis}={position:.9f}" for axis, position in positions), flush=True)
