"""CAN frames written out bit by bit from ISO 11898-1. Shares no code with drivers/frame_length.py; slow and plain."""

from drivers.frame import BRS, ESI, EXTENDED, EXTENDED_MASK, FD, FD_LENGTHS, REMOTE, STANDARD_MASK, Frame


def number(value: int, bits: int) -> list[int]:
    return [int(digit) for digit in f"{value:0{bits}b}"]


def crc(bits: list[int], polynomial: int, width: int) -> list[int]:
    """Remainder by long division, most significant bit first; the polynomial with its leading one."""
    work = bits + [0] * width
    divisor = number(polynomial, width + 1)
    for i in range(len(bits)):
        if work[i]:
            for j, digit in enumerate(divisor):
                work[i + j] ^= digit
    return work[-width:]


def stuff(bits: list[int], *, at_end: bool) -> list[tuple[int, int]]:
    """(bit, index of the source bit it is or follows): after each five equal bits, inserted ones too, a complement."""
    out: list[tuple[int, int]] = []
    for index, bit in enumerate(bits):
        out.append((bit, index))
        last_five = [b for b, _ in out[-5:]]
        ended = index == len(bits) - 1 and not at_end
        if len(last_five) == 5 and len(set(last_five)) == 1 and not ended:
            out.append((1 - bit, index))
    return out


def header(frame: Frame) -> list[int]:
    """SOF to DLC."""
    identifier = frame.can_id
    remote = 1 if identifier & REMOTE else 0
    length_code = number(FD_LENGTHS.index(len(frame.data)), 4)
    fd = bool(frame.flags & FD)
    if fd:
        tail = [1, 0, int(bool(frame.flags & BRS)), int(bool(frame.flags & ESI)), *length_code]  # FDF, res, BRS, ESI
    else:
        tail = [0, *length_code]  # r0 (FDF = 0)
    if identifier & EXTENDED:
        ident = number(identifier & EXTENDED_MASK, 29)
        middle = [] if fd else [0]  # classic extended frames have r1 and r0; in FD, FDF takes r1's place
        return [0, *ident[:11], 1, 1, *ident[11:], remote, *middle, *tail]
    return [0, *number(identifier & STANDARD_MASK, 11), remote, 0, *tail]


def payload(frame: Frame) -> list[int]:
    if frame.can_id & REMOTE:
        return []
    return [bit for byte in frame.data for bit in number(byte, 8)]


def classic_length(frame: Frame) -> int:
    """Bits from SOF to the end of EOF."""
    bits = header(frame) + payload(frame)
    bits += crc(bits, 0xC599, 15)
    return len(stuff(bits, at_end=True)) + 1 + 1 + 1 + 7  # CRC delimiter, ACK slot, ACK delimiter, EOF


def fd_length(frame: Frame) -> tuple[int, int]:
    """(bits up to and with BRS and from the ACK slot on, bits between) from SOF to the end of EOF."""
    head = header(frame)
    brs_index = len(head) - 6
    stuffed = stuff(head + payload(frame), at_end=False)
    # A stuff bit caused by BRS itself is sent after the switch, hence in the data phase.
    before = sum(
        1
        for i, (_, index) in enumerate(stuffed)
        if index < brs_index or (index == brs_index and (i == 0 or stuffed[i - 1][1] != brs_index))
    )
    between = len(stuffed) - before
    # Stuff count (3 bits Gray code, parity) and CRC: a fixed stuff bit before the first and after each four bits.
    checked = 4 + (21 if len(frame.data) > 16 else 17)
    fixed = 0
    for index in range(checked):
        if index % 4 == 0:
            fixed += 1
    return before + 1 + 1 + 7, between + checked + fixed + 1
