"""Who is on the bus: every node asked, each answer in its place, and nobody waited for for ever."""

from drivers.families.cia402.cia301 import SDO, Abort
from drivers.families.cia402.node_scan import LAST_NODE, NodeIdentity, NodeScan
from drivers.frame import Frame

OWN = 127
THREE = {
    (0x1000, 0): 0x00020192,
    (0x1018, 1): 0x11,
    (0x1018, 2): 0x22,
    (0x1018, 3): 0x33,
    (0x1018, 4): 0x44,
    (0x1001, 0): 0x05,
}


def answer(objects: dict[tuple[int, int], int], frame: Frame) -> Frame:
    """What a node that has these objects, and no name, says to a request."""
    _, index, subindex, _ = SDO.unpack(frame.data)
    found = objects.get((index, subindex))
    command, value = (0x43, found) if found is not None else (0x80, int(Abort.NO_OBJECT))
    return Frame(frame.can_id - 0x80, SDO.pack(command, index, subindex, value.to_bytes(4, "little")))


def scan(nodes: dict[int, dict[tuple[int, int], int]]) -> tuple[NodeScan, list[Frame]]:
    """A whole scan, and what it asked."""
    running, asked = NodeScan(OWN), []
    for _ in range(2000):
        frame = running.service()
        if frame is not None:
            asked.append(frame)
            node = frame.can_id - 0x600
            if node in nodes and frame.data[0] != 0x80:
                running.on_frame(answer(nodes[node], frame))
        if running.done:
            return running, asked
    raise AssertionError("it never ends")


def test_every_node_but_our_own_is_asked_and_those_that_answer_say_who_they_are() -> None:
    found, asked = scan({3: THREE, 126: {(0x1000, 0): 7}})
    assert [frame.can_id - 0x600 for frame in asked[: LAST_NODE - 1]] == [n for n in range(1, 128) if n != OWN]
    assert found.found == {
        3: NodeIdentity(3, 0x00020192, "", 0x11, 0x22, 0x33, 0x44, 0x05),
        126: NodeIdentity(126, 7),
    }


def test_a_name_comes_in_segments() -> None:
    running = NodeScan(OWN)
    while running.service() is not None:
        pass
    running.on_frame(Frame(0x585, SDO.pack(0x43, 0x1000, 0, bytes(4))))
    for _ in range(200):
        frame = running.service()
        if frame is None:
            continue
        if frame.data[1:4] == b"\x08\x10\x00":
            running.on_frame(Frame(0x585, SDO.pack(0x41, 0x1008, 0, (9).to_bytes(4, "little"))))
        elif frame.data[0] == 0x60:
            running.on_frame(Frame(0x585, b"\x00stepper"))
        elif frame.data[0] == 0x70:
            running.on_frame(Frame(0x585, b"\x1b-2\0\0\0\0\0"))
        else:
            running.on_frame(answer({}, frame))
    assert running.done
    assert running.found == {5: NodeIdentity(5, 0, "stepper-2")}


def test_a_node_that_falls_silent_is_given_up_and_told_so() -> None:
    running, asked = NodeScan(OWN), []
    while running.service() is not None:
        pass
    running.on_frame(Frame(0x584, SDO.pack(0x43, 0x1000, 0, bytes(4))))
    while not running.done:
        frame = running.service()
        asked += [frame] if frame else []
    aborts = [frame for frame in asked if frame.data[0] == 0x80]
    assert {frame.can_id for frame in asked} == {0x604}
    assert len(asked) == 2 * len(aborts) == 12
    assert {frame.data[4:] for frame in aborts} == {int(Abort.TIMEOUT).to_bytes(4, "little")}


def test_other_frames_are_passed_over() -> None:
    running = NodeScan(OWN)
    real = Frame(0x583, SDO.pack(0x43, 0x1000, 0, bytes(4)))
    for frame in (real._replace(can_id=0x580), real._replace(can_id=0x600), real._replace(flags=1)):
        running.on_frame(frame)
    running.on_frame(real._replace(data=real.data[:7]))
    assert running.found == {}
    running.on_frame(real)
    assert list(running.found) == [3]
