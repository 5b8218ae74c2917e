"""/metrics: what a monitoring system reads, who may, and that nothing old is shown. Read by the library's parser."""

import time
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from starlette.testclient import TestClient

from hil.page import hub as hub_module
from hil.page.access import Access, Role
from hil.page.audit import Audit
from hil.page.command import page
from hil.page.hub import Heard
from hil.page.metrics import exposition
from hil.page.server import Offers, PageServer, make_app
from hil.page.words import status_words
from hil.telemetry import telemetry_pb2 as pb
from tests.page.conftest import HOST, Told

AXES = {"x": "linear", "theta": "rotary"}


def status() -> dict[str, Any]:
    found = pb.Status(
        rig="paper", control_alive=True, recording=True, dropped=7, max_error=[2e-6, 3e-5],
        lateness_p50=1e-5, lateness_p99=2e-5, lateness_max=9e-5,
    )  # fmt: skip
    found.counters.missed_own, found.counters.missed_host, found.counters.sent = 1, 2, 4_000
    found.latched.name, found.latched.axis = "ENCODER_LOST", "x"
    return status_words(found)


def samples(text: bytes) -> dict[tuple[str, ...], float]:
    """Value by name and labels' values, as the library's own parser reads them."""
    return {
        (one.name, *(f"{key}={value}" for key, value in sorted(one.labels.items()))): one.value
        for family in text_string_to_metric_families(text.decode())  # type: ignore[no-untyped-call]
        for one in family.samples
    }


def test_every_figure_has_its_name_unit_and_labels() -> None:
    text, media_type = exposition({"paper": Heard(status(), AXES)})
    assert media_type.startswith("application/openmetrics-text")
    found = samples(text)
    assert found["hil_up", "rig=paper"] == 1.0
    assert found["hil_control_alive", "rig=paper"] == found["hil_recording", "rig=paper"] == 1.0
    assert found["hil_fault_latched", "axis=x", "fault=ENCODER_LOST", "rig=paper"] == 1.0
    assert found["hil_following_error_max_meters", "axis=x", "rig=paper"] == 2e-6
    assert found["hil_following_error_max_radians", "axis=theta", "rig=paper"] == 3e-5
    assert found["hil_tick_lateness_seconds", "quantile=0.99", "rig=paper"] == 2e-5
    assert found["hil_ticks_missed_total", "by=host", "rig=paper"] == 2.0
    assert found["hil_frames_total", "kind=sent", "rig=paper"] == 4_000.0
    assert found["hil_telemetry_dropped_total", "rig=paper"] == 7.0
    assert ("hil_following_error_max_meters", "axis=theta", "rig=paper") not in found


def test_a_rig_that_is_not_heard_shows_that_and_nothing_else() -> None:
    text, _ = exposition({"paper": Heard({}, AXES), "other": Heard(status(), AXES)})
    assert {name for name in samples(text) if "rig=paper" in name} == {("hil_up", "rig=paper")}
    assert samples(text)["hil_up", "rig=paper"] == 0.0


def test_a_figure_that_is_not_finite_is_left_out() -> None:
    shown = {**status(), "max_error": [None, 3e-5], "late": [None, None, None]}
    found = samples(exposition({"paper": Heard(shown, AXES)})[0])
    assert not [name for name in found if name[0] in ("hil_following_error_max_meters", "hil_tick_lateness_seconds")]


def test_names_of_rigs_cannot_break_out_of_their_labels() -> None:
    name = 'a"} 1\nhil_up{rig="b'
    assert list(samples(exposition({name: Heard({}, {})})[0])) == [("hil_up", f"rig={name}")]


@pytest.fixture
def scraped(access: Access, audit: Path, tmp_path: Path, told: Told) -> TestClient:
    """A program, not a browser: it has no cookie and no Origin."""
    notes = Audit(audit)
    server = PageServer(access, notes, ["paper"], tmp_path, cookie="hil_page", secure=False, offers=Offers(exposition))
    return TestClient(make_app(server, notes, [HOST], secure=False), base_url=f"http://{HOST}")


def test_a_program_reads_with_its_own_secret_until_it_is_revoked(scraped: TestClient, access: Access) -> None:
    with scraped as client:
        assert client.get("/metrics").status_code == 401
        secret, pairing = access.admit("prometheus", Role.WATCH)
        bearer = {"Authorization": f"Bearer {secret}"}
        answer = client.get("/metrics", headers=bearer)
        assert answer.status_code == 200
        assert samples(answer.content)["hil_up", "rig=paper"] == 0.0  # nobody has started its sidecar
        assert client.get("/runs", headers=bearer).status_code == 401  # figures, and no more
        assert client.get("/metrics", headers={"Authorization": f"Bearer {secret[:-1]}"}).status_code == 401
        access.revoke(pairing.name)
        assert client.get("/metrics", headers=bearer).status_code == 401


def test_an_old_status_is_none(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    hub = hub_module.Hub("paper")
    try:
        monkeypatch.setattr(type(hub.sidecar), "status", property(lambda _: status()))
        assert not hub.heard().status  # nothing was heard
        for age_s, heard in ((0.5, True), (1.1, False)):
            hub.sidecar._heard_s = time.monotonic() - age_s
            assert bool(hub.heard().status) is heard
        assert hub.heard().axes == {"x": "linear", "y": "linear"}
    finally:
        hub.sidecar.close()
        hub.ring.close()


def test_without_the_option_nobody_is_answered(client: TestClient, access: Access) -> None:
    secret, _ = access.admit("prometheus", Role.WATCH)
    assert client.get("/metrics", headers={"Authorization": f"Bearer {secret}"}).status_code == 404


def test_the_command_prints_a_secret_that_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    page(token="prometheus")
    out, err = capsys.readouterr()
    pairing = Access(tmp_path / "page", 5006).pairing_of(out.strip())
    assert pairing is not None
    assert (pairing.name, pairing.role) == ("prometheus", Role.WATCH)
    assert "--revoke prometheus" in err
