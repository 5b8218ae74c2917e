"""Who may: codes are good once, guesses are few, and what is revoked counts at once."""

import fcntl
import json
import re
import stat
import threading
from pathlib import Path

import pytest

from hil.page.access import LOCKED_S, WRONG, Access, PairingError, Role, spelt


def test_a_code_pairs_one_browser_for_its_role_and_a_new_one_takes_its_place(access: Access) -> None:
    code = access.codes[Role.STOP]
    secret, pairing = access.pair(spelt(code).lower(), "Ana's phone")
    assert (pairing.name, pairing.role) == ("Ana's phone", Role.STOP)
    assert access.pairing_of(secret) == pairing
    assert len(secret) == 43  # 256 bits in base64
    assert access.codes[Role.STOP] != code
    with pytest.raises(PairingError, match=r"cat .*codes"):
        access.pair(code, "another")


def test_the_codes_can_be_read_by_the_group_and_the_secrets_by_nobody(access: Access) -> None:
    secret, _ = access.pair(access.codes[Role.WATCH], "Ana")
    codes, pairings = access.codes_file, access.folder / "pairings.json"
    assert stat.S_IMODE(access.folder.stat().st_mode) == 0o750
    assert stat.S_IMODE(codes.stat().st_mode) == 0o640
    assert all(re.fullmatch(r"[A-Z2-9]{4}-[A-Z2-9]{4}", spelt(code)) for code in access.codes.values())
    assert stat.S_IMODE(pairings.stat().st_mode) == 0o600
    assert secret not in pairings.read_text()
    words = dict(line.split() for line in codes.read_text().splitlines())
    assert words == {role.name.lower(): spelt(code) for role, code in access.codes.items()}


def test_five_wrong_codes_end_pairing_for_a_while_and_spoil_the_codes(access: Access) -> None:
    code = access.codes[Role.OPERATE]
    for _ in range(WRONG):
        with pytest.raises(PairingError, match="no such code"):
            access.pair("AAAA-AAAA", "guesser", now_s=100.0)
    fresh = access.codes[Role.OPERATE]
    assert fresh != code
    with pytest.raises(PairingError, match="wait 30 s"):
        access.pair(fresh, "Ana", now_s=100.0)
    for _ in range(WRONG - 1):  # the count begins anew
        with pytest.raises(PairingError, match="no such code"):
            access.pair("AAAA-AAAA", "guesser", now_s=100.0 + LOCKED_S)
    assert access.pair(fresh, "Ana", now_s=100.0 + LOCKED_S)[1].role is Role.OPERATE


def test_a_right_code_forgives_the_wrong_ones_before_it(access: Access) -> None:
    for _ in range(3):
        for _ in range(WRONG - 1):
            with pytest.raises(PairingError, match="no such code"):
                access.pair("AAAA-AAAA", "clumsy", now_s=100.0)
        access.pair(access.codes[Role.WATCH], "clumsy", now_s=100.0)
    assert len(access.pairings()) == 3
    for _ in range(WRONG):
        with pytest.raises(PairingError, match="no such code"):
            access.pair("AAAA-AAAA", "guesser", now_s=100.0)
    with pytest.raises(PairingError, match="too many wrong codes"):
        access.pair(access.codes[Role.WATCH], "Ana", now_s=100.0)


def test_there_are_only_so_many_pairings(access: Access, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.page.access.MOST", 2)
    for name in ("Ana", "Ben"):
        access.pair(access.codes[Role.WATCH], name)
    with pytest.raises(PairingError, match=r"2 browsers are paired: .*--revoke NAME"):
        access.pair(access.codes[Role.WATCH], "Cleo")


def test_a_revocation_by_another_process_counts_at_once(access: Access) -> None:
    secret, _ = access.pair(access.codes[Role.OPERATE], "Ana")
    other, _ = access.pair(access.codes[Role.WATCH], "Ben")
    elsewhere = Access(access.folder)
    assert not elsewhere.revoke("nobody")
    assert elsewhere.revoke("Ana")
    assert access.pairing_of(secret) is None
    assert access.pairing_of(other) is not None


def test_a_revocation_waits_for_whoever_is_writing(access: Access) -> None:
    access.pair(access.codes[Role.OPERATE], "Ana")
    revoking = threading.Thread(target=Access(access.folder).revoke, args=("Ana",))
    with (access.folder / "pairings.lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        revoking.start()
        revoking.join(0.1)
        assert [pairing.name for pairing in access.pairings()] == ["Ana"]
    revoking.join(5.0)
    assert access.pairings() == []


def test_where_the_file_is_gone_nobody_is_paired(access: Access) -> None:
    secret, _ = access.pair(access.codes[Role.OPERATE], "Ana")
    (access.folder / "pairings.json").unlink()
    assert access.pairing_of(secret) is None


def test_names_are_fit_to_be_shown_and_never_the_same(access: Access) -> None:
    names = [
        access.pair(access.codes[Role.WATCH], text)[1].name
        for text in ("\x1b[2J\u202eAna", "Ana", "Ana", " ", "x" * 99)
    ]
    assert names == ["?[2J?Ana", "Ana", "Ana 2", "browser", f"{'x' * 40}..."]


@pytest.mark.parametrize(
    "content", ["", "{}", "[1]", '[{"name": "a"}]', '[{"name": 1, "role": 9, "digest": "", "wall": 0}]']
)
def test_a_damaged_file_lets_nobody_in(access: Access, content: str) -> None:
    secret, _ = access.pair(access.codes[Role.OPERATE], "Ana")
    (access.folder / "pairings.json").write_text(content)
    assert access.pairing_of(secret) is None


@pytest.mark.parametrize("secret", ["", None, "guess"])
def test_a_secret_that_is_none_is_nobodys(access: Access, secret: str | None) -> None:
    access.pair(access.codes[Role.OPERATE], "Ana")
    assert access.pairing_of(secret) is None


def test_pairings_outlive_the_page_and_codes_do_not(access: Access, tmp_path: Path) -> None:
    secret, pairing = access.pair(access.codes[Role.STOP], "Ana")
    again = Access(access.folder)
    again.renew()
    assert again.pairing_of(secret) == pairing
    assert not set(again.codes.values()) & set(access.codes.values())
    rows = json.loads((access.folder / "pairings.json").read_text())
    assert [row["name"] for row in rows] == ["Ana"]
