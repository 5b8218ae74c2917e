"""Prints the axes' positions and the gaps in a rig's ticks with eclipse-zenoh and protobuf alone: no import of hil.

python plain_subscriber.py ENDPOINT COUNT: ends after so many ticks.
"""

import json
import sys

import zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory


def main(endpoint: str, count: int) -> None:
    config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": [endpoint]}}))
    with zenoh.open(config) as session:
        samples = session.declare_subscriber("hil/*/tick", zenoh.handlers.RingChannel(4096))
        [reply] = list(session.get("hil/*/schema"))
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(reply.ok.payload.to_bytes()).file:
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("hil.telemetry.Tick"))
        states = kind.DESCRIPTOR.fields_by_name["state"].enum_type.values_by_number
        axes = [field.name for field in kind.DESCRIPTOR.fields if field.message_type]
        before = None
        for _ in range(count):
            tick = kind.FromString(samples.recv().payload.to_bytes())
            if before is not None and tick.sequence != before + 1:
                print("gap of", tick.sequence - before - 1, "after", before)
            before = tick.sequence
            print(before, states[tick.state].name, *(f"{axis}={getattr(tick, axis).position:g}" for axis in axes))
    assert "hil" not in sys.modules


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
