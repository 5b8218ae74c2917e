"""Tests of adapters whose package is not here are left to `make test-adapters`, which installs it."""

from collections.abc import Iterator
from importlib.util import find_spec

import pytest

import hil
from tests.adapters.windows import WINDOWS

NEEDS = {
    "test_pymmcore.py": "pymmcore_plus",
    "test_camera_source.py": "pymmcore_plus",
    "test_ophyd.py": "ophyd_async",
    "test_examples.py": "ophyd_async",
}
collect_ignore = [name for name, package in NEEDS.items() if find_spec(package) is None]


@pytest.fixture
def mover() -> Iterator[hil.VirtualMover]:
    """Of an emulated rig that holds, in virtual time."""
    with hil.motion(hil.load_rig("microscope-ideal", overrides=WINDOWS)) as mover:
        assert isinstance(mover, hil.VirtualMover)
        yield mover
