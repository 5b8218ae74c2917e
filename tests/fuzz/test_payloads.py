"""Damaged Zenoh payloads and command messages: monitor, dashboard, Python clients and sidecar stand."""

from collections.abc import Callable
from types import SimpleNamespace

import pytest

from hil.operate import dashboard
from tests.fuzz.payloads import batches, requests, status, statuses

FEW, MANY = 2_000, 20_000
TRIED = pytest.mark.parametrize("tried", [statuses, batches, requests])


@TRIED
def test_a_few_damaged_payloads_harm_nobody(tried: Callable[[int, int], dict[str, int]]) -> None:
    counts = tried(FEW, 1)
    assert sum(counts.values()) == FEW
    assert min(counts.values()) > 0


@pytest.mark.slow
@TRIED
def test_many_damaged_payloads_harm_nobody(tried: Callable[[int, int], dict[str, int]]) -> None:
    assert sum(tried(MANY, 2).values()) == MANY


def test_the_page_follows_a_status_with_other_axes() -> None:
    pytest.importorskip("bokeh", reason="the extra `dashboard` is not installed")
    from bokeh.document import Document

    fewer = status()
    for name in ("axes", "units", "position", "setpoint", "max_error", "force", "drive_status", "answer_age"):
        del getattr(fewer, name)[1:]
    lists_missing = status()
    lists_missing.ClearField("force")
    messages = [status(), fewer, lists_missing, status(), status()]
    client = SimpleNamespace(status=lambda: messages.pop(0), events=list, close=lambda: None)
    document = Document()
    page = dashboard.Page(document, client)  # type: ignore[arg-type]
    while messages:
        page.update()
    [root] = document.roots
    [source] = {id(found): found for found in root.select({"name": dashboard.SOURCE})}.values()
    assert len(source.data["position_1"]) == 2
