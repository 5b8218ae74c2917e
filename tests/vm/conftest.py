"""Fixtures of the tests that need a real CAN stack."""

import itertools
import os
import subprocess
from collections.abc import Callable, Iterator

import pytest

from tests.vm import links

_numbers = itertools.count()


def _missing() -> str | None:
    if os.geteuid() != 0:
        return "making CAN interfaces needs root"
    for module in ("can_raw", "vcan"):
        subprocess.run(["modprobe", module], capture_output=True, check=False)
    probe = subprocess.run(["ip", "link", "add", "hilprobe", "type", "vcan"], capture_output=True, check=False)
    if probe.returncode != 0:
        return "this kernel has no vcan"
    links.remove("hilprobe")
    return None


@pytest.fixture(scope="session", autouse=True)
def _can_stack() -> None:
    """These tests mean nothing without the kernel's CAN stack. In the lane its absence is a failure, never a skip."""
    reason = _missing()
    if reason and os.environ.get("HIL_VM"):
        pytest.fail(f"the VM lane has no CAN stack: {reason}")
    if reason:
        pytest.skip(f"{reason}; use: make test-vm")


@pytest.fixture
def new_vcan() -> Iterator[Callable[..., str]]:
    """Makes virtual CAN interfaces that are up; removed after the test."""
    names: list[str] = []

    def make(mtu: int = links.CANFD_MTU) -> str:
        name = f"vhil{next(_numbers)}"
        names.append(name)
        links.add_vcan(name, mtu)
        return name

    yield make
    for name in names:
        links.remove(name)


@pytest.fixture
def vcan(new_vcan: Callable[..., str]) -> str:
    """One FD-capable virtual CAN interface, up."""
    return new_vcan()
