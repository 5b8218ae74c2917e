"""Objects that a drive uploads by blocks alone: the master's transfer against the emulated drive's server."""

from collections.abc import Callable

import pytest

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import SDO, Abort, NmtState
from drivers.families.cia402.node import NodeMaster, Phase
from drivers.families.cia402.sdo import LONGEST_STRING, Progress, Step, Transfer, request_words, response_words
from hil.rig.file import load_rig
from sim_plant.drives.object_dictionary import ObjectDictionary, key_of
from sim_plant.drives.quirks import Quirks
from sim_plant.drives.sdo_server import SdoServer
from tests.support.bringup_bench import BringupBench
from tests.support.paths import RIGS

STRING = Step(0x2000, 0, 0)
OVER = (Progress.DONE, Progress.ABORTED)


def whole(frames: list[bytes]) -> list[bytes]:
    return frames


class Exchange:
    """A master's transfer with a server that insists on blocks. change: what becomes of the server's answers."""

    def __init__(self, content: bytes, longest: int = LONGEST_STRING) -> None:
        dictionary = ObjectDictionary(1)
        dictionary.values[key_of(0x2000)] = content
        self.server = SdoServer(dictionary, Quirks(answers="block"))
        self.transfer = Transfer(STRING, longest)
        self.requests: list[bytes] = []

    def run(self, change: Callable[[list[bytes]], list[bytes]] = whole) -> Progress:
        progress = Progress.CONTINUE
        while progress is Progress.CONTINUE and len(self.requests) < 200:
            self.requests.append(self.transfer.request())
            answers = change(self.server.on_request(self.requests[-1]))
            assert len(answers) == 1  # as the schedule counts on
            progress = self.transfer.answer(answers[0])
        return progress

    def closes(self) -> None:
        """What the master still says is not answered, and the server is free again."""
        assert self.transfer.closing
        assert self.server.on_request(self.transfer.closing) == []
        (answer,) = self.server.on_request(Transfer(Step(0x1000, 0, 0)).request())
        assert answer[0] == 0x43


@pytest.mark.parametrize("length", [5, 6, 7, 8, 13, 14, 15, 100, 255, 256])
def test_an_object_of_any_length_comes_whole(length: int) -> None:
    content = bytes(1 + at % 255 for at in range(length))
    exchange = Exchange(content)
    assert exchange.run() is Progress.DONE
    assert exchange.transfer.data == content
    assert exchange.transfer.value == int.from_bytes(content, "little")
    assert exchange.transfer.code == 0
    assert [request[0] for request in exchange.requests[:3]] == [0x40, 0xA4, 0xA3]  # asked plainly first
    assert exchange.requests[1] == SDO.pack(0xA4, 0x2000, 0, bytes((1, 0, 0, 0)))  # a segment a block, never plainly
    assert len(exchange.requests) == 3 + -(-length // 7)
    exchange.closes()


def test_what_is_short_needs_no_block() -> None:
    exchange = Exchange(b"abcd")
    assert exchange.run() is Progress.DONE
    assert (exchange.requests, exchange.transfer.closing) == ([SDO.pack(0x40, 0x2000, 0, bytes(4))], b"")


@pytest.mark.parametrize(("threshold", "command"), [(3, 0xC6), (4, 0x43), (5, 0x43)])
def test_a_server_answers_plainly_up_to_the_threshold_that_a_client_states(threshold: int, command: int) -> None:
    dictionary = ObjectDictionary(1)
    dictionary.values[key_of(0x2000)] = b"abcd"
    wanted = SDO.pack(0xA4, 0x2000, 0, bytes((127, threshold, 0, 0)))  # blocks of 127 segments
    for answers in ("expedited", "block"):
        (answer,) = SdoServer(dictionary, Quirks(answers=answers)).on_request(wanted)
        assert answer[0] == (command if answers == "expedited" else 0xC6)


def test_a_damaged_segment_is_found_by_the_checksum() -> None:
    exchange = Exchange(bytes(20))

    def damage(answers: list[bytes]) -> list[bytes]:
        return [a[:3] + b"!" + a[4:] if a[0] == 1 else a for a in answers]

    assert exchange.run(damage) is Progress.ABORTED
    assert exchange.transfer.code == Abort.CRC
    exchange.closes()


@pytest.mark.parametrize("told", [True, False])
def test_more_than_is_wanted_is_ended(told: bool) -> None:
    exchange = Exchange(bytes(30), 8)

    def change(answers: list[bytes]) -> list[bytes]:
        return answers if told else [bytes((a[0] & ~2,)) + a[1:] if a[0] >> 5 == 6 else a for a in answers]

    assert exchange.run(change) is Progress.ABORTED
    assert exchange.transfer.code == Abort.TOO_LONG
    assert len(exchange.requests) == (2 if told else 5)
    exchange.closes()


def test_a_server_that_has_no_blocks_either_is_believed_first() -> None:
    transfer = Transfer(STRING)
    refusal = SDO.pack(0x80, 0x2000, 0, Abort.UNSUPPORTED.to_bytes(4, "little"))
    assert transfer.answer(refusal) is Progress.CONTINUE
    again = SDO.pack(0x80, 0x2000, 0, Abort.COMMAND.to_bytes(4, "little"))
    assert transfer.answer(again) is Progress.ABORTED
    assert (transfer.code, transfer.closing) == (Abort.UNSUPPORTED, b"")


@pytest.mark.parametrize("code", [Abort.NO_OBJECT, Abort.WRITE_ONLY, Abort.OUT_OF_MEMORY])
def test_no_other_refusal_leads_to_a_block(code: Abort) -> None:
    transfer = Transfer(STRING)
    assert transfer.answer(SDO.pack(0x80, 0x2000, 0, code.to_bytes(4, "little"))) is Progress.ABORTED
    write = Transfer(Step(0x2000, 0, 1, 1))
    assert write.answer(SDO.pack(0x80, 0x2000, 0, Abort.COMMAND.to_bytes(4, "little"))) is Progress.ABORTED


def test_an_abort_within_a_block_and_answers_to_others_are_told_apart() -> None:
    exchange = Exchange(bytes(range(65, 85)))
    foreign = [SDO.pack(0x43, 0x6041, 0, bytes(4)), SDO.pack(0xC6, 0x1008, 0, bytes(4)), bytes((2, *range(7)))]

    def with_foreign(answers: list[bytes]) -> list[bytes]:
        assert {exchange.transfer.answer(frame) for frame in foreign} == {Progress.FOREIGN}
        return answers

    assert exchange.run(with_foreign) is Progress.DONE
    assert exchange.transfer.data == bytes(range(65, 85))
    ended = Exchange(bytes(20))

    def end(answers: list[bytes]) -> list[bytes]:
        gone = SDO.pack(0x80, 0x2000, 0, Abort.TIMEOUT.to_bytes(4, "little"))
        return [gone if a[0] == 1 else a for a in answers]

    assert ended.run(end) is Progress.ABORTED
    assert (ended.transfer.code, ended.transfer.closing) == (Abort.TIMEOUT, b"")


def test_a_step_of_the_bring_up_is_read_by_blocks_and_the_next_follows() -> None:
    content = b"abcdefg"
    dictionary = ObjectDictionary(1)
    dictionary.values[key_of(0x2000)] = content
    server = SdoServer(dictionary, Quirks(answers="block"))
    number = int.from_bytes(content, "little")
    steps = [Step(0x2000, 0, number, mask=(1 << 64) - 1), Step(0x1000, 0, 0x192, mask=0xFFFF)]
    node = NodeMaster(1, steps)
    sent = []
    for tick in range(0, 40, 2):
        frame = node.service(tick)
        if frame is None or node.phase is not Phase.CONFIGURE:
            break
        sent.append(frame.data[0])
        for answer in server.on_request(frame.data):
            assert node.on_sdo(answer)
    assert node.phase is Phase.START
    assert sent == [0x40, 0xA4, 0xA3, 0xA2, 0xA1, 0x40]
    assert node.values == {(0x2000, 0): number, (0x1000, 0): 0x20192}
    node.on_heartbeat(NmtState.BOOT_UP)
    assert node.phase is Phase.CONFIGURE


def test_a_survey_reads_the_name_of_a_drive_that_insists() -> None:
    settings = ["bus.protocol=cia402", "plant.drive.kind=cia402", "plant.drive.answers=block"]
    report = BringupBench(load_rig(RIGS / "paper.toml", settings), RIGS).survey()
    names = {node.identity.name for node in report.nodes}
    assert names == {"Emulated servo drive, CiA 402 cyclic synchronous torque"}
    assert report.ready


def test_block_transfers_have_words() -> None:
    asked = SDO.pack(0xA4, 0x1008, 0, bytes((1, 0, 0, 0)))
    assert request_words(asked) == "SDO read 1008h:00 by blocks"
    assert request_words(SDO.pack(0xC6, 0x1F50, 1, bytes(4))) == "SDO write 1F50h:01 by blocks"
    assert request_words(bytes((0xA1, *bytes(7)))) == "SDO segment"
    assert response_words(SDO.pack(0xC6, 0x1008, 0, bytes(4))) == "SDO 1008h:00: by blocks"
    assert response_words(SDO.pack(0xA4, 0x1F50, 1, bytes(4))) == "SDO 1F50h:01: by blocks"
    assert cia301.Abort(0x06010000) is Abort.UNSUPPORTED
