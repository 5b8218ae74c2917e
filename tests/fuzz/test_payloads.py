"""Damaged Zenoh payloads and command messages: monitor, page, Python clients and sidecar stand."""

from collections.abc import Callable

import pytest

from tests.fuzz.payloads import batches, requests, statuses

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
