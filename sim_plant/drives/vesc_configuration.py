"""The configurations of an emulated VESC, and the packets in which it tells them over CAN.

Source: the firmware's release 6.06 (github.com/vedderb/bldc: confgenerator.h, confgenerator.c, comm/comm_can.c). Of the
configurations the values in FIELDS are emulated; all others are zero. Packets are written from the same source and not
from our host's side of them.
"""

from collections.abc import Mapping
from struct import Struct

from drivers.frame import EXTENDED, Frame

COMM_FW_VERSION, COMM_GET_MCCONF, COMM_GET_APPCONF = 0, 14, 17
FILL_RX_BUFFER, FILL_RX_BUFFER_LONG, PROCESS_RX_BUFFER, PROCESS_SHORT_BUFFER = 5, 6, 7, 8
FIRMWARE = bytes((COMM_FW_VERSION, 6, 6)) + b"60_MK6\0" + bytes(12)
SIZES = {COMM_GET_MCCONF: 483, COMM_GET_APPCONF: 278}  # bytes, without the packet's number
FIELDS = {  # of which configuration, from which byte on, how it is written
    "mcconf_signature": (COMM_GET_MCCONF, 0, ">I"),
    "motor_type": (COMM_GET_MCCONF, 6, ">B"),
    "sensor_mode": (COMM_GET_MCCONF, 7, ">B"),
    "l_current_max": (COMM_GET_MCCONF, 8, ">f"),
    "l_current_min": (COMM_GET_MCCONF, 12, ">f"),
    "l_in_current_max": (COMM_GET_MCCONF, 16, ">f"),
    "l_in_current_min": (COMM_GET_MCCONF, 20, ">f"),
    "l_current_max_scale": (COMM_GET_MCCONF, 81, ">h"),  # in 1e-4
    "appconf_signature": (COMM_GET_APPCONF, 0, ">I"),
    "controller_id": (COMM_GET_APPCONF, 4, ">B"),
    "timeout_msec": (COMM_GET_APPCONF, 5, ">I"),
    "timeout_brake_current": (COMM_GET_APPCONF, 9, ">f"),
}
SET_BY_NOBODY = {  # as a VESC for a motor with an encoder has them
    "mcconf_signature": 788332866,
    "motor_type": 2,  # FOC
    "sensor_mode": 2,
    "l_in_current_max": 10.0,
    "l_in_current_min": -10.0,
    "l_current_max_scale": 10_000,
    "appconf_signature": 2099347128,
    "timeout_brake_current": 0.0,
}
_POLYNOMIAL = 0x1021


def configuration(number: int, values: Mapping[str, float]) -> bytes:
    """The answer to COMM_GET_MCCONF or COMM_GET_APPCONF. values: of FIELDS, by name."""
    packet = bytearray(1 + SIZES[number])
    packet[0] = number
    for name, (where, at, form) in FIELDS.items():
        if where == number:
            value = values[name]
            Struct(form).pack_into(packet, 1 + at, value if form == ">f" else round(value))
    return bytes(packet)


def answer(packet: bytes, vesc_id: int, asker: int) -> list[Frame]:
    """The frames in which a VESC sends a packet to who asked it."""
    if len(packet) <= 6:
        return [_frame(PROCESS_SHORT_BUFFER, asker, bytes((vesc_id, 1)) + packet)]
    frames, at = [], 0
    while at < len(packet):
        if at <= 255:
            head, size, command = bytes((at,)), 7, FILL_RX_BUFFER
        else:
            head, size, command = at.to_bytes(2, "big"), 6, FILL_RX_BUFFER_LONG
        frames.append(_frame(command, asker, head + packet[at : at + size]))
        at += size
    end = bytes((vesc_id, 1)) + len(packet).to_bytes(2, "big") + crc16(packet).to_bytes(2, "big")
    return [*frames, _frame(PROCESS_RX_BUFFER, asker, end)]


def crc16(data: bytes) -> int:
    """The packets' CRC, bit by bit."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (_POLYNOMIAL if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def _frame(command: int, vesc_id: int, data: bytes) -> Frame:
    return Frame(EXTENDED | command << 8 | vesc_id, data)
