"""A viewer of the Foxglove protocol: read with nothing but the protocol and the schemas that come with the streams."""

import base64
import json
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from hil.cycle.state_machine import State
from hil.page.access import Access, Role
from hil.page.audit import Audit
from hil.page.foxglove import SUBPROTOCOLS, WAITING, LiveStreams
from hil.page.server import Offers, PageServer, make_app
from hil.page.sidecar_feed import SidecarFeed
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from tests.page.conftest import HOST, Told

OFFERS = Offers(streams=LiveStreams, subprotocols=SUBPROTOCOLS, waiting=WAITING)
ELSEWHERE = {"Origin": "https://app.foxglove.dev"}  # a viewer's own page, or none at all


@pytest.fixture
def viewer(access: Access, audit: Path, tmp_path: Path) -> Iterator[TestClient]:
    notes = Audit(audit)
    server = PageServer(access, notes, ["paper"], tmp_path, cookie="hil_page", secure=False, offers=OFFERS)
    with TestClient(make_app(server, notes, [HOST], secure=False), base_url=f"http://{HOST}") as client:
        yield client


@pytest.fixture
def address(access: Access) -> str:
    return f"/foxglove/paper?token={access.admit('lichtblick', Role.WATCH)[0]}"


def opened(client: TestClient, address: str) -> WebSocketTestSession:
    return client.websocket_connect(address, subprotocols=[SUBPROTOCOLS[1], "other"], headers=ELSEWHERE)


class Reader:
    """Knows the protocol alone: channels by topic, and what decodes their messages."""

    def __init__(self, session: WebSocketTestSession) -> None:
        self.session = session
        self.info = self.text()
        self.channels: dict[str, Any] = {}
        self.advertised()

    def text(self) -> Any:
        return json.loads(self.session.receive_text())

    def advertised(self) -> None:
        told = self.text()
        assert told["op"] == "advertise"
        self.channels = {each["topic"]: each for each in told["channels"]}

    def subscribe(self, **numbers: int) -> None:
        rows = [{"id": number, "channelId": self.channels[topic]["id"]} for topic, number in numbers.items()]
        self.session.send_text(json.dumps({"op": "subscribe", "subscriptions": rows}))

    def message(self, topic: str) -> tuple[int, int, Any]:
        """Subscription, ns since 1970, and the message as its schema says."""
        data = self.session.receive_bytes()
        opcode, subscription, at_ns = struct.unpack_from("<BIQ", data)
        assert opcode == 1
        channel = self.channels[topic]
        assert channel["encoding"] == channel["schemaEncoding"] == "protobuf"
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
        return subscription, at_ns, kind.FromString(data[13:])


def ticking(told: Told, first: int) -> Callable[[], None]:
    """Ticks from number `first` on until the answer is called."""
    over = threading.Event()

    def tick() -> None:
        index = first
        while not over.wait(0.005):
            told.tick(index, force=0.5)
            index += 1

    thread = threading.Thread(target=tick)
    thread.start()

    def end() -> None:
        over.set()
        thread.join()

    return end


def test_ticks_come_as_a_recording_has_them_and_only_to_who_subscribes(
    told: Told, viewer: TestClient, address: str
) -> None:
    told.tick(1)
    with opened(viewer, address) as session:
        assert session.accepted_subprotocol == SUBPROTOCOLS[1]
        reader = Reader(session)
        assert reader.info["op"] == "serverInfo"
        assert set(reader.channels) == {"tick", "status", "events"}
        reader.subscribe(tick=7)
        end = ticking(told, 2)
        try:
            ticks = [reader.message("tick") for _ in range(20)]
        finally:
            end()
    assert {subscription for subscription, _, _ in ticks} == {7}
    numbers = [message.tick for _, _, message in ticks]
    assert numbers == list(range(numbers[0], numbers[0] + 20))
    assert numbers[0] >= 2  # the one before was there before anybody subscribed
    assert all(message.x.force == pytest.approx(0.5, rel=1e-2) for _, _, message in ticks)
    assert ticks[0][2].state == State.ACTIVE
    offset_ns = time.time_ns() - time.monotonic_ns()
    assert ticks[0][1] == pytest.approx(offset_ns + 1, abs=60e9)  # wall clock; these ticks were due at 1 ns


def test_statuses_and_events_come_as_the_sidecar_told_them(
    told: Told, viewer: TestClient, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told.tick(1)
    status = pb.Status(rig="paper", law="pd", index=5)
    happened = [pb_events.Event(sequence=n, line=f"event {n}", wall_ns=1_700_000_000_000_000_000 + n) for n in range(3)]
    monkeypatch.setattr(SidecarFeed, "message", property(lambda _: status))
    monkeypatch.setattr(SidecarFeed, "told", property(lambda _: len(happened)))
    monkeypatch.setattr(SidecarFeed, "event_messages", lambda _, told: (len(happened), happened[told:]))
    with opened(viewer, address) as session:
        reader = Reader(session)
        reader.subscribe(events=1)
        found = [reader.message("events") for _ in happened]
        reader.subscribe(status=2)
        number, _, heard = reader.message("status")
    assert [(at, message.line) for _, at, message in found] == [(event.wall_ns, event.line) for event in happened]
    assert (number, heard.law, heard.index) == (2, "pd", 5)


def test_a_viewer_that_unsubscribes_gets_no_more(told: Told, viewer: TestClient, address: str) -> None:
    told.tick(1)
    with opened(viewer, address) as session:
        reader = Reader(session)
        reader.subscribe(tick=7)
        end = ticking(told, 2)
        try:
            reader.message("tick")
            session.send_text(json.dumps({"op": "unsubscribe", "subscriptionIds": [7]}))
            session.send_text(json.dumps({"op": "getParameters"}))
            while "bytes" in (told_back := session.receive()):
                pass
        finally:
            end()
    assert json.loads(told_back["text"])["message"].startswith("'getParameters': this server takes")


def test_the_next_control_process_is_advertised_anew(viewer: TestClient, address: str) -> None:
    first = Told()
    first.tick(1)
    with opened(viewer, address) as session:
        reader = Reader(session)
        old = {topic: channel["id"] for topic, channel in reader.channels.items()}
        first.ring.close()
        second = Told()
        second.tick(1)
        gone = reader.text()
        assert gone["op"] == "unadvertise"
        assert sorted(gone["channelIds"]) == sorted(old.values())
        reader.advertised()
        assert not {channel["id"] for channel in reader.channels.values()} & set(old.values())
        session.send_text(json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": old["tick"]}]}))
        assert reader.text()["message"] == f"no channel {old['tick']}"
        second.ring.close()


@pytest.mark.parametrize("secret", ["", "?token=", "?token=guessed"])
def test_who_has_no_secret_is_refused(told: Told, viewer: TestClient, audit: Path, secret: str) -> None:
    told.tick(1)
    with opened(viewer, f"/foxglove/paper{secret}") as session, pytest.raises(WebSocketDisconnect) as refused:
        session.receive_text()
    assert refused.value.code == 4401
    assert json.loads(audit.read_text().splitlines()[-1])["status"] == 401


def test_a_paired_browsers_cookie_does_not_count_and_the_secret_is_in_no_audit(
    told: Told, viewer: TestClient, access: Access, audit: Path, address: str
) -> None:
    told.tick(1)
    secret, _ = access.admit("Ana", Role.OPERATE)
    viewer.cookies.set("hil_page", secret)
    with opened(viewer, "/foxglove/paper") as session, pytest.raises(WebSocketDisconnect) as refused:
        session.receive_text()
    assert refused.value.code == 4401
    with opened(viewer, address):
        pass
    assert address.partition("token=")[2] not in audit.read_text()


def test_a_secret_that_is_revoked_ends_the_stream(told: Told, viewer: TestClient, access: Access, address: str) -> None:
    told.tick(1)
    with opened(viewer, address) as session:
        Reader(session)
        access.revoke("lichtblick")
        with pytest.raises(WebSocketDisconnect) as ended:
            session.receive_text()
    assert ended.value.code == 4401


@pytest.mark.parametrize(
    "text", ["no JSON", '{"op": "subscribe"}', '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}']
)
def test_nonsense_ends_the_stream(told: Told, viewer: TestClient, address: str, text: str) -> None:
    told.tick(1)
    with opened(viewer, address) as session:
        Reader(session)
        session.send_text(text)
        with pytest.raises(WebSocketDisconnect) as ended:
            session.receive_text()
    assert ended.value.code == 1008


def test_another_host_is_refused_here_too(told: Told, viewer: TestClient, address: str) -> None:
    headers = {**ELSEWHERE, "Host": "evil.example"}
    with pytest.raises(WebSocketDisconnect), viewer.websocket_connect(address, headers=headers):
        pass


def test_without_the_option_there_is_nothing(client: TestClient, address: str) -> None:
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(address):
        pass
