"""Bit-exact lengths of CAN frames on the wire (ISO 11898-1:2015, clauses 10.4 and 10.5), by byte tables.

Classic: every bit from SOF to the end of the CRC-15 is stuffed dynamically, so the length depends on the payload and on
its real CRC. FD: bits from SOF to the last data bit are stuffed dynamically. From there fixed stuff bits make the
length of stuff count and CRC-17/21 independent of their values, so no CRC has to be calculated.

Stuffing is a state machine over (last bit, length of its run); its transition for a whole byte is one table look-up.
For FD payloads of up to 24 bytes the stuff bits so far are made part of the state, so that a byte costs one index and
nothing else. The simulated wire asks for every frame of every tick.
"""

from functools import cache, lru_cache
from typing import Any

from drivers.frame import BRS, ESI, EXTENDED, EXTENDED_MASK, FD, FD_LENGTHS, REMOTE, STANDARD_MASK, Frame

INTERMISSION = 3  # recessive bits between frames
ACK_TO_EOF = 1 + 1 + 7  # ACK slot, ACK delimiter, end of frame
CRC15_POLYNOMIAL = 0x4599
FD_LONG_PAYLOAD = 16  # bytes; longer payloads carry CRC-21 instead of CRC-17

# A stuffing state is last_bit * 5 + run - 1 with run in 1..5. A run of 5 means that a stuff bit is due before the next
# bit: dynamic stuffing puts it there, the end of an FD data field does not (a fixed stuff bit takes its place).
_STATES = 10
_AFTER_SOF = 0  # one dominant bit seen
_PENDING = (4, 9)

# A row of the linked machine stands for a state and a number of stuff bits: at index `byte` it has the row after that
# byte, at _COUNT the number.
_Row = list[Any]
_COUNT = 256
_LINKED_BYTES = 24

# A running value v = stuff_bits << 12 | state << 8. Adding _BYTE_STEP[v & 0xF00 | byte] advances it by eight bits.
_COUNT_SHIFT = 12
_STATE_MASK = 0xF00


def _next_state(state: int, bit: int) -> tuple[int, int]:
    """State after one more bit, and how many stuff bits went before it (0 or 1)."""
    last, run = divmod(state, 5)
    stuffed = 0
    if run == 4:
        stuffed, last, run = 1, 1 - last, 0
    return (last * 5 + run + 1 if bit == last else bit * 5), stuffed


def _advance(v: int, value: int, bits: int) -> int:
    """Running value after the `bits` lowest bits of `value`, most significant first."""
    for shift in range(bits - 1, -1, -1):
        state, stuffed = _next_state((v & _STATE_MASK) >> 8, value >> shift & 1)
        v = (v >> _COUNT_SHIFT) + stuffed << _COUNT_SHIFT | state << 8
    return v


def _step_table(bits: int) -> list[int]:
    """Differences to add to a running value, indexed by state << 8 | value of `bits` bits."""
    table = [0] * (_STATES << 8)
    for state in range(_STATES):
        for value in range(1 << bits):
            table[state << 8 | value] = _advance(state << 8, value, bits) - (state << 8)
    return table


def _crc15(crc: int, value: int, bits: int) -> int:
    """CRC-15 register after the `bits` lowest bits of `value`, most significant first."""
    for shift in range(bits - 1, -1, -1):
        feedback = (crc >> 14) ^ (value >> shift & 1)
        crc = crc << 1 & 0x7FFF
        if feedback:
            crc ^= CRC15_POLYNOMIAL
    return crc


_BYTE_STEP = _step_table(8)
_SEVEN_BIT_STEP = _step_table(7)
_CRC15_STEP = [_crc15(0, byte, 8) for byte in range(256)]


@lru_cache(maxsize=4096)
def _classic_header(can_id: int, length: int) -> tuple[int, int, int]:
    """Running value and CRC-15 register after the DLC, and the frame's bits SOF to EOF without stuff bits."""
    remote = 1 if can_id & REMOTE else 0
    if can_id & EXTENDED:
        identifier = can_id & EXTENDED_MASK
        # base id, SRR, IDE, extension, RTR, r1, r0, DLC
        value = (identifier >> 18) << 27 | 0b11 << 25 | (identifier & 0x3FFFF) << 7 | remote << 6 | length
        bits = 38
    else:
        value, bits = (can_id & STANDARD_MASK) << 7 | remote << 6 | length, 18  # id, RTR, IDE, r0, DLC
    payload_bits = 0 if remote else 8 * length
    return (
        _advance(_AFTER_SOF << 8, value, bits),
        _crc15(_crc15(0, 0, 1), value, bits),
        1 + bits + payload_bits + 15 + 1 + ACK_TO_EOF,
    )


@lru_cache(maxsize=4096)
def _fd_header(can_id: int, flags: int, length: int) -> tuple[int, int, int]:
    """Running value after the DLC with the stuff bits of the data phase alone; nominal bits; data-phase bits without
    stuff bits. Of the two bits in which the rate changes, BRS counts as nominal and the CRC delimiter as a data bit:
    each lasts partly at either rate, and together they last exactly one bit of each.
    """
    if length not in FD_LENGTHS:
        raise ValueError(f"FD frame {can_id:#x} with {length} bytes: an FD frame carries one of {FD_LENGTHS}")
    switch = 1 if flags & BRS else 0
    if can_id & EXTENDED:
        identifier = can_id & EXTENDED_MASK
        # base id, SRR, IDE, extension, RRS, FDF, res, BRS
        value = (identifier >> 18) << 24 | 0b11 << 22 | (identifier & 0x3FFFF) << 4 | 0b0100 | switch
        bits = 35
    else:
        value, bits = (can_id & STANDARD_MASK) << 5 | 0b00100 | switch, 16  # id, RRS, IDE, FDF, res, BRS
    v = _advance(_AFTER_SOF << 8, value, bits)
    nominal = 1 + bits + (v >> _COUNT_SHIFT) + ACK_TO_EOF
    esi_and_dlc = (1 << 4 if flags & ESI else 0) | FD_LENGTHS.index(length)
    v = _advance(v & _STATE_MASK, esi_and_dlc, 5)
    return v, nominal, 5 + 8 * length + crc_field_bits(length) + 1


@cache
def _linked_rows() -> list[list[_Row]]:
    """The rows by number of stuff bits and state, far enough for _LINKED_BYTES behind a header. Made when first asked
    for: 1.1 MB that a process without FD frames does not need."""
    most = 2 + 8 * _LINKED_BYTES // 4 + 1  # a header brings up to two, four equal bits one each, the last byte may pass
    rows: list[list[_Row]] = [[[None] * _COUNT + [count] for _ in range(_STATES)] for count in range(most + 3)]
    for count in range(most):
        for state in range(_STATES):
            steps = [_BYTE_STEP[state << 8 | byte] + (state << 8) for byte in range(_COUNT)]
            rows[count][state][:_COUNT] = [rows[count + (v >> _COUNT_SHIFT)][v >> 8 & 0xF] for v in steps]
    return rows


@lru_cache(maxsize=4096)
def _fd_start(can_id: int, flags: int, length: int) -> tuple[_Row, int, int]:
    """As _fd_header, with the row in place of the running value."""
    v, nominal, data_bits = _fd_header(can_id, flags, length)
    return _linked_rows()[v >> _COUNT_SHIFT][v >> 8 & 0xF], nominal, data_bits


def crc_field_bits(length: int) -> int:
    """Bits of an FD frame's stuff count and CRC with their fixed stuff bits, without the delimiter."""
    return 4 + 21 + 7 if length > FD_LONG_PAYLOAD else 4 + 17 + 6


def classic_bits(can_id: int, data: bytes) -> int:
    """Bits of a classic frame, SOF to the end of EOF, stuff bits included. A remote frame's `data` gives its DLC."""
    v, crc, bits = _classic_header(can_id, len(data))
    if not can_id & REMOTE:
        for byte in data:
            v += _BYTE_STEP[v & 0xF00 | byte]
            crc = (crc << 8 & 0x7FFF) ^ _CRC15_STEP[crc >> 7 ^ byte]
    v += _BYTE_STEP[v & 0xF00 | crc >> 7]
    v += _SEVEN_BIT_STEP[v & 0xF00 | crc & 0x7F]
    return bits + (v >> 12) + ((v & 0xF00) >> 8 in _PENDING)


def fd_bits(can_id: int, data: bytes, flags: int) -> tuple[int, int]:
    """(nominal-rate bits, data-rate bits) of an FD frame from SOF to the end of EOF, stuff bits included. Without BRS
    the data bits, too, are sent at the nominal rate."""
    length = len(data)
    if length > _LINKED_BYTES:
        return _long_fd_bits(can_id, data, flags)
    row, nominal, data_bits = _fd_start(can_id, flags, length)
    for byte in data:
        row = row[byte]
    return nominal, data_bits + row[_COUNT]


def _long_fd_bits(can_id: int, data: bytes, flags: int) -> tuple[int, int]:
    v, nominal, data_bits = _fd_header(can_id, flags, len(data))
    for byte in data:
        v += _BYTE_STEP[v & 0xF00 | byte]
    return nominal, data_bits + (v >> 12)


def frame_bits(frame: Frame) -> tuple[int, int]:
    """(bits at the nominal rate, bits at the data rate) of a frame from SOF to the end of EOF, no intermission.

    Raises ValueError for a payload length the format does not have.
    """
    can_id, data, flags, _ = frame
    if flags & FD:
        bits = fd_bits(can_id, data, flags)
        return bits if flags & BRS else (sum(bits), 0)
    if len(data) > 8:
        raise ValueError(f"classic frame {can_id:#x} with {len(data)} bytes: a classic frame carries 0 to 8")
    return classic_bits(can_id, data), 0


def longest_bits(frame: Frame) -> tuple[int, int]:
    """As frame_bits for the worst payload a frame of this size can have: same for all payloads. Raises ValueError."""
    nominal, fast = worst_case_bits(len(frame.data), fd=bool(frame.flags & FD), extended=bool(frame.can_id & EXTENDED))
    return nominal - INTERMISSION, fast


def worst_case_bits(length: int, *, fd: bool, extended: bool) -> tuple[int, int]:
    """(nominal, data-rate) bits no frame of that length exceeds, with the intermission: the frame's cost on the bus.

    Classic: Davis et al. 2007, equation 1: 8n + g + 13 + floor((g + 8n - 1) / 4) with g = 34 (11-bit) or 54 (29-bit
    identifiers). FD (with bit-rate switch): one stuff bit after each four bits behind the first, from SOF to the data's
    end. Both bits in which the rate changes count as nominal ones, which covers every sample point and the extra
    nominal bit of phase shift that ISO 11898-1 allows there.
    """
    if fd:
        if length not in FD_LENGTHS:
            raise ValueError(f"length = {length}: an FD frame carries one of {FD_LENGTHS} bytes")
        head = 36 if extended else 17  # SOF to BRS
        stuffed_head = (head - 1) // 4
        stuffed = (head + 5 + 8 * length - 1) // 4
        return (
            head + stuffed_head + 1 + ACK_TO_EOF + INTERMISSION,
            5 + 8 * length + stuffed - stuffed_head + crc_field_bits(length),
        )
    if not 0 <= length <= 8:
        raise ValueError(f"length = {length}: a classic frame carries 0 to 8 bytes")
    stuffable = 54 if extended else 34
    return 8 * length + stuffable + 13 + (stuffable + 8 * length - 1) // 4, 0
