"""Recordings of the earlier layout (topics `telemetry` and `traffic`, in batches), as the sidecar wrote them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from hil.telemetry import codec
from hil.telemetry import telemetry_pb2 as pb

BATCH = 50  # ticks
Change = Callable[[pb.Traffic, int], pb.Traffic | None]


def unchanged(message: pb.Traffic, _number: int) -> pb.Traffic:
    """No change."""
    return message


def write_earlier(path: Path, metadata: dict[str, Any], records: np.ndarray, change: Change = unchanged) -> Path:
    """Record ticks; each Traffic message as change(message, number) gives it back, None: left out."""
    axes = len(metadata["rig"]["axes"])
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=64 * 1024, compression=CompressionType.ZSTD)
        writer.start(profile="hil", library="hil 0")
        writer.add_attachment(0, 0, "run.json", "application/json", json.dumps(metadata).encode())
        channels = {}
        for topic, kind in (("telemetry", pb.Telemetry), ("traffic", pb.Traffic)):
            files = build_file_descriptor_set(kind).SerializeToString()
            schema = writer.register_schema(kind.DESCRIPTOR.full_name, "protobuf", files)
            channels[topic] = writer.register_channel(topic, "protobuf", schema)
        for number, first in enumerate(range(0, len(records), BATCH)):
            batch = records[first : first + BATCH]
            at = int(batch["now_ns"][-1])
            telemetry = codec.telemetry(batch, axes, batch=number, first=first).SerializeToString()
            writer.add_message(channels["telemetry"], at, telemetry, at, number)
            traffic = change(codec.traffic(batch, first=first), number)
            if traffic is not None:
                writer.add_message(channels["traffic"], at, traffic.SerializeToString(), at, number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
