"""`hil doctor` in the guest, where there is CAN: every kind of interface, and what the kernel grants."""

from collections.abc import Callable

import pytest

from hil.operate import doctor
from tests.vm import links
from tests.vm.doctor_truth import untruths

pytestmark = pytest.mark.vcan


def test_what_it_says_is_true_with_interfaces_of_every_kind(new_vcan: Callable[..., str]) -> None:
    fd, classic, down = new_vcan(), new_vcan(mtu=links.CAN_MTU), new_vcan()
    links.ip("link", "set", down, "down")
    findings = doctor.examine()
    assert untruths([finding._asdict() for finding in findings]) == []
    levels = {finding.topic: finding.level for finding in findings}
    assert [levels[f"CAN {name}"] for name in (fd, classic, down)] == ["ok", "note", "warn"]
    links.ip("link", "set", down, "up")
    said_before = [finding._asdict() for finding in findings]
    assert len(untruths(said_before)) == 1, "what was true before the interface came up is an untruth now"
