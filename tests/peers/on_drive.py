"""A pytest plug-in: canopen's own tests take `hil drive`'s emulated drive as the device.

Where a test creates a device on the bus (`Network.create_node`), our drive stands there, by the same EDS file; the test
looks into it through `sdo` and `nmt`, as it would into the package's own. Where a test has the device's frames written
down, our drive answers, and its answers are held against those in the test.
"""

import threading
import time
from pathlib import Path
from typing import Any

import canopen
import pytest
from canopen.nmt import NMT_STATES
from canopen.pdo import PDO, RPDO, TPDO
from canopen.sdo.base import SdoBase

from drivers.bus.any_bus import AnyPort, joined
from drivers.config import BusConfig
from drivers.families.cia402.cia301 import NmtState
from drivers.frame import Frame
from sim_plant.config import EmulatedDriveConfig
from sim_plant.drive_double import DoubleSettings, DriveDouble, make_drive
from sim_plant.drives.motion_drive import MotionDrive
from sim_plant.drives.object_dictionary import SdoAbort, key_of
from tests.peers.results import met

SETTINGS = DoubleSettings(1.0, 4096, 1e-4, 1e-3, 0.0, 0.0, EmulatedDriveConfig(kind="cia402"))
_PATIENCE_S = 5.0


class Inside(SdoBase):
    """The drive's own view of its objects, in the package's terms."""

    def __init__(self, drive: MotionDrive, lock: threading.Lock, od: Any) -> None:
        super().__init__(0, 0, od)
        self._drive, self._lock = drive, lock

    def upload(self, index: int, subindex: int) -> bytes:
        with self._lock:
            return self._drive.dictionary.read(index, subindex)

    def download(self, index: int, subindex: int, data: bytes, force_segment: bool = False) -> None:
        with self._lock:
            put(self._drive, index, subindex, data)


def put(drive: MotionDrive, index: int, subindex: int, data: bytes) -> None:
    """Give an object a value from inside the drive, whatever access a master has."""
    dictionary = drive.dictionary
    entry = dictionary.entry(index, subindex)
    try:
        dictionary.write(index, subindex, data)
    except SdoAbort:
        dictionary.values[key_of(index, subindex)] = entry.type.unpack(data)


class InsideNmt:
    """state: as the package names it."""

    def __init__(self, drive: MotionDrive, lock: threading.Lock) -> None:
        self._drive, self._lock = drive, lock

    @property
    def state(self) -> str:
        with self._lock:
            return NMT_STATES[int(self._drive.nmt)]

    @state.setter
    def state(self, name: str) -> None:
        with self._lock:
            if name == "INITIALISING":
                self._drive.reboot()
            else:
                self._drive.nmt = NmtState[name.replace("-", "_")]

    def stop_heartbeat(self) -> None:
        with self._lock:
            put(self._drive, 0x1017, 0, bytes(2))


class OurNode:
    """Our drive on the network's bus, in a thread, until `remove_network`."""

    def __init__(self, node_id: int, eds: str, channel: str) -> None:
        self.id = node_id
        drive = make_drive(Path(eds), node_id, SETTINGS, time.monotonic_ns())
        self._lock = threading.Lock()
        self._ending, here = threading.Event(), threading.Event()
        self.object_dictionary = canopen.import_od(eds, node_id)
        self.sdo, self.nmt = Inside(drive, self._lock, self.object_dictionary), InsideNmt(drive, self._lock)
        self.network: Any = None
        self.rpdo, self.tpdo = RPDO(self), TPDO(self)
        self.pdo = PDO(self, self.rpdo, self.tpdo)
        self._thread = threading.Thread(target=self._serve, args=(drive, channel, here))
        self._thread.start()
        assert here.wait(_PATIENCE_S)

    def _serve(self, drive: MotionDrive, channel: str, here: threading.Event) -> None:
        with joined(BusConfig(protocol="cia402", interface="local", channel=channel), fd=False) as port:
            double = DriveDouble([drive], port, lambda _text: None, every=False)
            self._step(double, port)
            here.set()
            while not self._ending.is_set():
                self._step(double, port)

    def _step(self, double: DriveDouble, port: AnyPort) -> None:
        first = port.wait(0.002)
        now_ns = time.monotonic_ns()
        with self._lock:
            double.step(([first] if first else []) + port.drain(now_ns), now_ns)

    def associate_network(self, network: Any) -> None:
        """It is on the bus already."""
        for part in (self, self.sdo, self.pdo, self.rpdo, self.tpdo):
            part.network = network

    def remove_network(self) -> None:
        self._ending.set()
        self._thread.join()


_create, _disconnect = canopen.Network.create_node, canopen.Network.disconnect


def create_node(network: Any, node: int, object_dictionary: Any = None) -> Any:
    if network.bus is None or not isinstance(object_dictionary, str):
        return _create(network, node, object_dictionary)
    met()
    network[node] = OurNode(node, object_dictionary, str(network.bus.channel))
    return network.nodes[node]


def disconnect(network: Any) -> None:
    for node in network.nodes.values():
        if isinstance(node, OurNode):
            node.remove_network()
    _disconnect(network)


# frames that are written down in a test -----------------------------------------------------------------------------

TX, RX = 1, 2
_READS, _ABORT = (0x40, 0xA4), 0x80


def told_value(script: list[tuple[int, bytes]]) -> bytes | None:
    """What the device of a script has in the object that is read; None where none is read, or not to the end."""
    command, answers = script[0][1][0], [data for way, data in script if way == RX]
    if not answers or command >> 5 not in (2, 5) or answers[0][0] == 0x80:
        return None
    first = answers[0]
    if command >> 5 == 5:
        return None if len(answers) > 100 else _block(answers)
    if first[0] & 0x02:
        return first[4 : 8 - (first[0] >> 2 & 3)] if first[0] & 0x01 else first[4:]
    return b"".join(segment[1 : 8 - (segment[0] >> 1 & 7)] for segment in answers[1:])


def _block(answers: list[bytes]) -> bytes:
    return b"".join(data[1:] for data in answers[1:-1])[: int.from_bytes(answers[0][4:], "little")]


def meaning(answer: bytes) -> bytes:
    """A device's answer without bytes that mean nothing: the tests have fillers there, and made-up lengths."""
    kind = answer[0] >> 5
    if kind == 1:  # a segment of a download is taken
        return answer[:1]
    if kind == 2:  # an upload begins; what it brings is asserted by the test
        return answer[: 8 - (answer[0] >> 2 & 3)] if answer[0] & 0x03 == 0x03 else answer[:4]
    return answer[: 8 - (answer[0] >> 1 & 7)] if kind == 0 and answer[0] & 0x01 else answer


class Conversation:
    """One test's network, with our drive behind it."""

    def __init__(self, test: Any, eds: str) -> None:
        self._test = test
        self._drive = make_drive(Path(eds), 2, SETTINGS, 0)
        self._drive.advance(1)
        self.differences: list[str] = []

    def send(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """A frame of the client. The answers are ours; the script's are what they are held against."""
        test = self._test
        script = test.data
        assert script[0][0] == TX, "no transmission was expected"
        self._set(script)
        script.pop(0)
        expected = []
        while script and script[0][0] == RX:
            expected.append(script.pop(0)[1])
        answers = [frame.data for frame in self._drive.on_frame(Frame(can_id, bytes(data).ljust(8, b"\0"), 0, 1))]
        self.differences += [
            f"they answer {theirs.hex(' ')}, we {ours.hex(' ')}"
            for theirs, ours in zip(expected, answers, strict=False)
            if meaning(theirs) != meaning(ours)
        ]
        if len(expected) != len(answers):
            self.differences.append(f"they answer with {len(expected)} frames, we with {len(answers)}")
        for answer in answers:
            test.network.notify(0x582, answer, 0.0)
        test.message_sent = True

    def _set(self, script: list[tuple[int, bytes]]) -> None:
        """Where a transfer begins, our object gets the value of theirs, or is taken away where theirs has none."""
        request = script[0][1]
        if request[0] not in _READS:
            return
        index, subindex = int.from_bytes(request[1:3], "little"), request[3]
        begun = [at for at, (way, data) in enumerate(script) if way == TX and data[0] in _READS]
        part = script[: begun[1]] if len(begun) > 1 else script
        dictionary = self._drive.dictionary
        value = told_value(part)
        if part[1][1][0] == _ABORT:
            del dictionary.entries[key_of(index, subindex)]
        elif value is not None and dictionary.has(index, subindex):
            put(self._drive, index, subindex, value)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Any:
    """The device in a scripted test is ours."""
    test: Any = getattr(item, "instance", None)
    if not hasattr(test, "_send_message"):
        return (yield)
    met()
    eds = "datatypes.eds" if "Datatypes" in type(test).__name__ else "sample.eds"
    conversation = Conversation(test, str(item.path.with_name(eds)))
    test._send_message = conversation.send  # setUp gives it to the network
    result = yield
    assert not conversation.differences, "\n".join(conversation.differences)
    return result


setattr(canopen.Network, "create_node", create_node)  # noqa: B010
setattr(canopen.Network, "disconnect", disconnect)  # noqa: B010
