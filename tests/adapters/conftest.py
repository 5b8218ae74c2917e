"""Tests of adapters whose package is not here are left to `make test-adapters`, which installs it."""

from importlib.util import find_spec

NEEDS = {"test_pymmcore.py": "pymmcore_plus", "test_ophyd.py": "ophyd_async", "test_examples.py": "ophyd_async"}
collect_ignore = [name for name, package in NEEDS.items() if find_spec(package) is None]
