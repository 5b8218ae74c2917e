"""Frame layouts that go wrong, each in its own way: what is appended to examples/layouts/maker.py, and what is said."""

from pathlib import Path

from tests.support.paths import ROOT

MAKER = ROOT / "examples" / "layouts" / "maker.py"
_WRONG_HOST = "    def host(self):\n        return WrongHost(self.wiring.n_axes, self.torque_unit)\n"
_WRONG_DRIVES = "    def drives(self):\n        return WrongDrives(self.wiring, self.torque_unit)\n"


def layout(body: str) -> str:
    """A class Wrong with this body."""
    return f"\n\nclass Wrong(Maker):\n{body}"


def host(body: str) -> str:
    """A class Wrong whose host's side has this body."""
    return f"\n\nclass WrongHost(MakerHost):\n{body}{layout(_WRONG_HOST)}"


def messages(change: str) -> str:
    """A host's side that changes its first message in this way, and has no other."""
    return host(
        "    def messages(self, period_ns):\n        first = super().messages(period_ns)[0]\n"
        f"        return [first._replace({change})]\n"
    )


def drives(body: str) -> str:
    """A class Wrong whose drives' side has this body."""
    return f"\n\nclass WrongDrives(MakerDrives):\n{body}{layout(_WRONG_DRIVES)}"


def encode(line: str) -> str:
    """A host's side that does this with its frames, a tick's number being `k`."""
    return host(
        "    k = 0\n\n    def encode(self, command):\n        frames = super().encode(command)\n        self.k += 1\n"
        f"        {line}\n        return frames\n"
    )


def decode(line: str) -> str:
    """A host's side that does this with a Sample that it has read, its number being `k`."""
    return host(
        "    k = 0\n\n    def decode(self, frame):\n        sample = super().decode(frame)\n"
        "        if isinstance(sample, Sample):\n            self.k += 1\n"
        f"            {line}\n        return sample\n"
    )


REFUSED = {
    "is none": ("\n\nclass Wrong:\n    def host(self):\n        pass\n", "'Wrong' is no class with host and drives"),
    "is abstract": ("\n\nclass Wrong(FrameLayout):\n    pass\n", "it cannot be made: "),
    "raises when made": (layout("    def __init__(self, wiring):\n        1 / 0\n"), "ZeroDivisionError"),
    "carries it not": (
        layout("    def __init__(self, wiring):\n        raise ValueError('three axes at most')\n"),
        "it cannot be made: ./wrong.py:",
    ),
    "host raises": (layout("    def host(self):\n        raise SystemExit(3)\n"), "host(): ./wrong.py:"),
    "one side": (
        layout("    def drives(self):\n        return self.host()\n"),
        "host() and drives(): both are MakerHost; the two sides are written apart",
    ),
    "no encode": (
        layout("    def host(self):\n        return object()\n"),
        "host(): object has no decode and no encode and no messages",
    ),
    "no feedback": (
        layout("    def drives(self):\n        return object()\n"),
        "drives(): object has no decode_command and no encode_feedback",
    ),
    "modulus in words": (host("    sequence_modulus = 'many'\n"), "sequence_modulus = 'many', expected a whole number"),
    "states in words": (host("    states = 'yes'\n"), "states = 'yes', expected True or False"),
    "positions of one": (host("    positions = [(-9, 9)]\n"), "expected (least, greatest) for 2 axes"),
    "positions in words": (host("    positions = 'all'\n"), "positions = 'all', expected (least, greatest)"),
    "acts of one": (host("    acts_ns = [5]\n"), "acts_ns = [5], expected ns for 2 axes"),
    "echo in words": (host("    echo_id = 'go'\n"), "echo_id = 'go', expected an identifier or None"),
    "echo of another": (host("    echo_id = 0x7\n"), "echo_id = 0x7 is no message of its own"),
    "no messages": (
        host("    def messages(self, period_ns):\n        return []\n"),
        "returned [], not a list of Messages",
    ),
    "half messages": (
        host("    def messages(self, period_ns):\n        return super().messages(period_ns)[:3]\n"),
        "nothing in its list is sent by 'axis 0'",
    ),
    "message in words": (host("    def messages(self, period_ns):\n        return ['go']\n"), "expected a Message"),
    "nobody's message": (
        messages("sender='x'"),
        "sender = 'x', expected one of host, axis 0, axis 1",
    ),
    "message too long": (
        messages("length=9"),
        "no length of a frame",
    ),
    "message after none": (
        messages("after='x'"),
        "after = 'x' is the name of no message",
    ),
    "encodes nothing": (encode("frames = None"), "expected a list of Frames"),
    "encodes bytes": (encode("frames = [b'go']"), "expected a Frame with bytes"),
    "encodes text": (encode("frames = [Frame(1, 'go')]"), "expected a Frame with bytes"),
    "encodes too much": (encode("frames += [Frame(GO_ID, bytes(9))]"), "a frame of 9 bytes: 180#0000"),
    "encodes another id": (
        encode("frames += [Frame(0x77, bytes(1))]"),
        "sends 77#00, whose identifier is none of messages() of the host",
    ),
    "encodes FD": (encode("frames += [Frame(GO_ID, bytes(64), 4)]"), "sends a CAN FD frame, and fd is False"),
    "encode raises": (encode("1 / 0"), "host().encode: ./wrong.py:"),
    "enables all": (
        encode("frames = super().encode(command._replace(enable=3))"),
        "host() enables axes 0b0, and 0b11 is read",
    ),
    "enables nobody without the first": (
        encode("frames = super().encode(command._replace(enable=command.enable * (command.enable & 1)))"),
        "host() enables axes 0b10, and 0b0 is read",
    ),
    "enables one at most": (
        encode("frames = super().encode(command._replace(enable=command.enable & -command.enable))"),
        "host() enables axes 0b11, and 0b1 is read",
    ),
    "loses the counter": (
        encode("frames = super().encode(command._replace(sequence=7))"),
        "host() sends sequence 0, and 7 is read",
    ),
    "another scale": (
        encode("frames = super().encode(command._replace(force=[2 * f for f in command.force]))"),
        "is read; force_resolution",
    ),
    "never goes": (encode("frames = frames[:-1]"), "reads no command in what host() sends in 40 ticks"),
    "decodes a number": (decode("sample = 5"), "returned 5, expected a Sample, a Reject"),
    "decodes an axis too many": (decode("sample.axis = 2"), "a Sample of axis 2; there are 2, from 0"),
    # A compiled Sample refuses these two itself.
    "decodes half a count": (decode("sample.position = 0.5"), "host().decode of 281#"),
    "decodes unknown bits": (decode("sample.status = 1 << 12"), "status 4096 has bits that DriveStatus does not know"),
    "decodes no counter": (decode("sample.sequence = -1"), "sequence -1; sequence_modulus is 256"),
    "decodes no time": (decode("sample.stamp_ns = None"), "host().decode of 281#"),
    "decodes another axis": (decode("sample.axis = 1"), "makes no sample of what the drive of axis 0 answers"),
    "decodes another count": (decode("sample.position += 1"), "says position 0, and 1 is read"),
    "decodes no fault": (decode("sample.status &= ~2"), "says status "),
    "decode raises": (decode("1 / 0"), "host().decode of 281#"),
    "decodes noise": (
        host("    def decode(self, frame):\n        frame.data[6]\n        return super().decode(frame)\n"),
        "IndexError",
    ),
    "reads a word": (
        drives("    def decode_command(self, frame):\n        return 'go'\n"),
        "returned 'go', expected a Command or a Reject",
    ),
    "reads one axis": (
        drives("    def decode_command(self, frame):\n        return Command(0, [0.0], 0, False)\n"),
        "which is none for 2 axes",
    ),
    "reads noise": (
        drives(
            "    def decode_command(self, frame):\n        frame.data[0]\n"
            "        return super().decode_command(frame)\n"
        ),
        "drives().decode_command: ./wrong.py:",
    ),
    "answers nothing": (
        drives("    def encode_feedback(self, sample):\n        return None\n"),
        "drives().encode_feedback: ./wrong.py: returned None",
    ),
    "coarse beyond words": (drives("    def __init__(self, wiring, unit):\n        super().__init__(wiring, unit)\n"
                                   "        self.force_resolution = 2.0\n"), "force_resolution = 2.0, expected 0 to 1"),
}  # fmt: skip


def write(folder: Path, text: str) -> Path:
    """wrong.py in a folder: the example and this text."""
    path = folder / "wrong.py"
    path.write_text(MAKER.read_text() + text)
    return path
