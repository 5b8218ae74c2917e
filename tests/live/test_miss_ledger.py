"""Whose fault a missed tick is: the host's, or our own."""

import resource
import time

import pytest

from hil.live.miss_ledger import MissLedger

PERIOD = 1_000_000


@pytest.fixture
def ledger():
    made = MissLedger(PERIOD)
    yield made
    made.close()


def test_a_slot_lost_without_using_the_core_is_the_hosts(ledger):
    ledger.book(2, overrun=2, cpu_ns=60_000, sleeps=10**9)
    assert (ledger.own, ledger.host, ledger.longest) == (0, 2, 2)


def test_a_slot_lost_by_computing_is_our_own(ledger):
    ledger.book(3, overrun=3, cpu_ns=2_500_000, sleeps=10**9)
    assert (ledger.own, ledger.host, ledger.longest) == (2, 1, 3)


def test_a_slot_lost_by_waiting_for_something_is_our_own(ledger):
    ledger.take_stock(0)
    for _ in range(3):
        time.sleep(0.001)  # gives up the core; no pacing sleep accounts for it
    ledger.book(1, overrun=1, cpu_ns=0, sleeps=0)
    assert (ledger.own, ledger.host) == (1, 0)


def test_a_late_wake_is_the_hosts_even_when_the_thread_waited_for_something_before(ledger):
    ledger.take_stock(0)
    time.sleep(0.001)
    time.sleep(0.001)
    ledger.book(4, overrun=0, cpu_ns=9_000_000, sleeps=0)
    assert (ledger.own, ledger.host) == (0, 4)


def test_pacing_sleeps_are_not_taken_for_blocking(ledger, monkeypatch):
    """The kernel's counters are played: this thread, unlike the loop's, has others to wait for."""
    major_faults, voluntary_switches = 7, 14  # their places in the structure
    usage = [0] * 16
    monkeypatch.setattr(resource, "getrusage", lambda who: resource.struct_rusage(usage))
    ledger.take_stock(100)
    usage[voluntary_switches] += 3
    assert not ledger.take_stock(103)
    usage[voluntary_switches] += 4
    assert ledger.take_stock(106)
    usage[major_faults] += 1
    assert ledger.take_stock(106)
    assert not ledger.take_stock(106)


def test_totals_add_up_and_the_longest_loss_is_kept(ledger):
    for skipped in (1, 4, 2):
        ledger.book(skipped, overrun=skipped, cpu_ns=0, sleeps=10**9)
    assert (ledger.own + ledger.host, ledger.longest) == (7, 4)
