"""The npm package `canopen` over the kernel's bus: as the master of our drive, and as the drives under our master."""

import pytest

from tests.foreign.npm_package import Place, package
from tests.foreign.test_npm_canopen import test_it_walks_a_drive_through_all_that_a_master_asks
from tests.foreign.test_npm_drive import (
    test_a_fault_of_theirs_is_told_in_words,
    test_our_master_brings_them_to_torque_and_back,
)

__all__ = [  # of tests/foreign, where they run over the local bus
    "package",
    "test_a_fault_of_theirs_is_told_in_words",
    "test_it_walks_a_drive_through_all_that_a_master_asks",
    "test_our_master_brings_them_to_torque_and_back",
]

pytestmark = pytest.mark.vcan


@pytest.fixture
def place(vcan: str) -> Place:
    return Place("socketcan", vcan, rate_hz=20.0)
