"""Names the markers for the guest, which has no pyproject.toml."""


def pytest_configure(config):
    for marker in ("vcan: needs a CAN stack", "systemd: needs systemd as init and the installed package"):
        config.addinivalue_line("markers", marker)
