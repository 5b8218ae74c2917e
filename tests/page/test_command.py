"""`hil page` on the command line: where it may listen, what it prints, who is paired."""

import builtins
from pathlib import Path
from typing import Any

import pytest
from typer import BadParameter, Exit

from hil.page import command
from hil.page.access import Access, Role
from hil.page.command import allowed_hosts


def test_on_loopback_it_answers_to_loopbacks_names_alone() -> None:
    assert allowed_hosts("127.0.0.1", [], 5006, secure=False) == ["localhost:5006", "127.0.0.1:5006", "[::1]:5006"]
    assert "localhost" in allowed_hosts("127.0.0.1", [], 80, secure=False)
    assert "localhost" not in allowed_hosts("127.0.0.1", [], 80, secure=True)


@pytest.mark.parametrize("bind", ["0.0.0.0", "192.0.2.7", "::"])
def test_beyond_loopback_it_is_refused_without_tls(bind: str) -> None:
    with pytest.raises(BadParameter, match="--certificate and --key"):
        allowed_hosts(bind, ["rig1"], 5006, secure=False)


def test_on_all_addresses_it_must_be_told_its_name() -> None:
    with pytest.raises(BadParameter, match="--host NAME"):
        allowed_hosts("0.0.0.0", [], 5006, secure=True)
    assert "rig1:5006" in allowed_hosts("0.0.0.0", ["rig1"], 5006, secure=True)
    assert "192.0.2.7:5006" in allowed_hosts("192.0.2.7", [], 5006, secure=True)
    with pytest.raises(BadParameter, match="expected an IP address"):
        allowed_hosts("rig1", [], 5006, secure=True)


def test_without_its_server_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    original = builtins.__import__

    def without_uvicorn(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name == "uvicorn":
            raise ImportError(name)
        return original(name, *arguments, **keywords)

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(builtins, "__import__", without_uvicorn)
    with pytest.raises(Exit) as ended:
        command.page(None)
    assert ended.value.exit_code == 69
    assert "-m pip install 'hil[page]'" in capsys.readouterr().err


def test_browsers_are_listed_and_revoked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    access = Access(command.state_folder())
    access.renew()
    secret, _ = access.pair(access.codes[Role.OPERATE], "Ana")
    command.page(None, paired=True)
    assert "operate " in capsys.readouterr().out
    command.page(None, revoke="Ana")
    assert capsys.readouterr().out == "0 paired\n"
    assert access.pairing_of(secret) is None
    with pytest.raises(Exit) as ended:
        command.page(None, revoke="Ana")
    assert ended.value.exit_code == 1


def test_the_service_keeps_its_state_where_systemd_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/hil")
    assert command.state_folder() == Path("/var/lib/hil/page")
