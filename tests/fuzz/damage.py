"""How files are damaged: what editors, disks, cables and people who mean harm do to them."""

import random
import struct

LONG = 70_000
PIECES = [
    b"",
    b"\x00",
    b"\xff",
    b"\xff\xfe",
    b"\n",
    b"\r",
    b'"',
    b"'''",
    b"[[",
    b"]]",
    b"{",
    b"}",
    b"=",
    b".",
    b",",
    b";",
    b"#",
    b"nan",
    b"inf",
    b"-1",
    b"1e999",
    b"9" * 400,
    b"0x" + b"f" * 5000,
    b"[" * 2000,
    b"a." * 3000,
    b"true",
    b"1979-05-27",
    b"\\",
    b"\x1b[2J",
    b"x" * LONG,
    b"BO_ 1 M: 8 A\n",
    b"99999999",
    b":",
    b"|",
    b"@",
    b'SG_ S : 0|8@1+ (1,0) [0|1] "" B\n',
    b"SG_MUL_VAL_ 1 A B 0-4294967295;",
    b"(0,0)",
    b"0|0",
    b"CompactSubObj=0xFFFFFFFF\n",
    b"ObjectType=0x8\n",
    b"$NODEID+$NODEID",
    b"[1018sub1]\n",
    *(struct.pack("<q", number) for number in (0, -1, 1, 2**31, 2**62, -(2**63))),
    *(struct.pack("<I", number) for number in (0xFFFFFFFF, 0x80000000, 65536)),
    struct.pack("<d", float("nan")),
    struct.pack("<d", 1e300),
]


def damaged(content: bytes, chance: random.Random) -> bytes:
    """The content with one to five pieces cut out, doubled, moved or replaced, bits or bytes changed; or cut short."""
    data = bytearray(content)
    for _ in range(chance.randint(1, 5)):
        first = chance.randrange(len(data) + 1)
        last = min(len(data), first + chance.choice([0, 1, 1, 2, 5, 20, 100]))
        way = chance.randrange(6)
        if way == 0:
            data[first:last] = chance.choice(PIECES)
        elif way == 1:
            data[first:first] = data[first:last] * chance.choice([1, 1, 2, 50])
        elif way == 2:
            piece = data[first:last]
            del data[first:last]
            place = chance.randrange(len(data) + 1)
            data[place:place] = piece
        elif way == 3 and first < len(data):
            data[first] ^= 1 << chance.randrange(8)
        elif way == 4 and chance.random() < 0.2:
            del data[first:]
        elif first < len(data):
            data[first] = chance.randrange(256)
    return bytes(data)
