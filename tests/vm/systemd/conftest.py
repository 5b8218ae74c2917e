"""The tests of the systemd guest are one story, told in the order of their files."""

import pytest

from tests.vm.systemd.stage import powered


def pytest_configure(config):
    # the guest has no pyproject.toml
    for marker in ("vcan: needs a CAN stack", "systemd: needs systemd as init and the installed package"):
        config.addinivalue_line("markers", marker)


@pytest.fixture(autouse=True)
def _story_goes_on(request):
    """A step that failed makes the following ones meaningless: say so instead of failing them for other reasons."""
    if getattr(request.session, "broken", None):
        pytest.fail(f"an earlier step failed: {request.session.broken}")
    yield
    if request.session.testsfailed:
        request.session.broken = request.node.name


@pytest.fixture(scope="session")
def powered_stage():
    """The stage across the bus, from when it is first powered to the end of the story."""
    with powered():
        yield
