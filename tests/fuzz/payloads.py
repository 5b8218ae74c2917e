"""Zenoh payloads and command messages, damaged: whoever shows or judges them neither falls over nor passes on commands
to a terminal or a browser.
"""

import io
import json
import random
from collections.abc import Iterator
from typing import Any

from google.protobuf.message import DecodeError
from rich.console import Console

from hil.connection import _changes
from hil.operate import monitor
from hil.page.words import status_words
from hil.telemetry import codec
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import decoded
from hil.telemetry.command_wire import LIMIT, REQUEST, WireError, frame, opened, seal, unframe
from tests.fuzz.damage import damaged

HOSTILE = (
    "", "\x1b[2J\x1b]0;owned\x07", "<script>alert(1)</script>", "[/red]", "[link=http://x]y[/link]", "\u202e", "\n\r",
    "x" * 70_000, "'\"&", "\u0000", "é" * 300, "{0}", "%s",
)  # fmt: skip
NUMBERS = (
    0, 1, -1, 2**31, 2**32 - 1, 2**63 - 1, -(2**63), 2**64 - 1,
    0.0, -0.0, 1e308, 5e-324, float("nan"), float("inf"),
)  # fmt: skip
NONCE = bytes(16)


def status() -> pb.Status:
    """One of a rig that moves."""
    return pb.Status(
        rig="paper", state="ACTIVE", fault="NONE", axes=["x", "y"], units=["m", "rad"], law="pd-feedforward",
        period_ns=1_000_000, index=1234, now_ns=10**12, tick_ns=10**12 - 10**6, pid=7, control_alive=True,
        position=[0.001, -0.2], setpoint=[0.001, -0.2], max_error=[1e-6, 2e-9], force=[1.0, -2.0],
        drive_status=[1, 17], answer_age=[0.0, 0.7], lateness_p50=1e-6, lateness_p99=1e-5, lateness_max=1e-4,
        realtime="granted", faults_active=["ENCODER_LOST"], drive_problems=["x: refused"], recording_path="run.mcap",
        counters=pb.Counters(sent=5, received=6, rejects=[0, 1, 2], saturations=[0, 1]),
    )  # fmt: skip


def telemetry() -> pb.Telemetry:
    """A batch of three ticks of two axes."""
    message = pb.Telemetry(batch=3, first=7, axes=2, counters=pb.Counters(sent=5))
    for name in codec.PER_TICK:
        getattr(message, name).extend([1, 2, 3])
    for name in codec.PER_AXIS:
        getattr(message, name).extend([1, 2, 3, 4, 5, 6])
    message.cpu_ns.extend(range(15))
    return message


def distorted(message: Any, chance: random.Random) -> bytes:
    """A valid message with one to four fields of any value and any number."""
    for _ in range(chance.randint(1, 4)):
        field = chance.choice(message.DESCRIPTOR.fields)
        if field.type == field.TYPE_MESSAGE:
            continue
        value = chance.choice(HOSTILE if field.type == field.TYPE_STRING else NUMBERS)
        try:
            if not isinstance(getattr(message, field.name), str | bytes | int | float):
                getattr(message, field.name)[:] = [_as(field, value)] * chance.choice([0, 1, 2, 3, 5, 300])
            else:
                setattr(message, field.name, _as(field, value))
        except (ValueError, TypeError, OverflowError):  # a number that this field cannot have
            continue
    return bytes(message.SerializeToString())


def _as(field: Any, value: Any) -> Any:
    integer = field.cpp_type not in (field.CPPTYPE_DOUBLE, field.CPPTYPE_FLOAT, field.CPPTYPE_STRING)
    return int(value) if integer else value


def _payloads(make: Any, count: int, chance: random.Random) -> Iterator[bytes]:
    whole = make().SerializeToString()
    for number in range(count):
        yield damaged(whole, chance) if number % 2 else distorted(make(), chance)


def statuses(count: int, seed: int) -> dict[str, int]:
    """Monitor and page on so many payloads; how many were shown and left out. Raises AssertionError."""
    chance, counts = random.Random(seed), {"shown": 0, "left out": 0}
    for number, payload in enumerate(_payloads(status, count, chance)):
        found = decoded(payload)
        if found is None:
            counts["left out"] += 1
            continue
        counts["shown"] += 1
        age_s = chance.choice([0.0, 3.0])
        texts = [monitor.line(found, age_s), json.dumps(status_words(found), allow_nan=False, ensure_ascii=False)]
        if number % 20 == 0:
            out = io.StringIO()
            Console(file=out, width=120, color_system=None).print(monitor.view(found, age_s))
            texts.append(out.getvalue())
        for text in texts:
            assert not any(ord(letter) < 32 and letter != "\n" for letter in text), ascii(text[:300])
    return counts


def batches(count: int, seed: int) -> dict[str, int]:
    """What a Python program that is connected makes of so many batches of ticks. Raises AssertionError."""
    counts = {"shown": 0, "left out": 0}
    for payload in _payloads(telemetry, count, random.Random(seed)):
        try:
            columns = codec.columns(pb.Telemetry.FromString(payload))
            list(_changes(columns, {}))
            counts["shown"] += 1
        except (DecodeError, ValueError):
            counts["left out"] += 1
    return counts


def requests(count: int, seed: int) -> dict[str, int]:
    """What the sidecar makes of so many messages of a command connection. Raises whatever it does not expect."""
    chance, counts = random.Random(seed), {"shown": 0, "left out": 0}
    secret = b"s" * 32
    for number in range(count):
        body = pb.CommandRequest(kind=1, sequence=number + 1, expires_ns=10**12).SerializeToString()
        sealed = frame(seal(damaged(body, chance)[: LIMIT // 2] if number % 3 else body, REQUEST, NONCE, secret))
        buffer = bytearray(damaged(sealed, chance) if number % 2 else sealed)
        try:
            message = unframe(buffer)
            inner = opened(message, REQUEST, NONCE, secret) if message is not None else None
            if inner is None:
                counts["left out"] += 1
                continue
            pb.CommandRequest.FromString(inner)
            counts["shown"] += 1
        except (WireError, DecodeError):
            counts["left out"] += 1
    return counts
