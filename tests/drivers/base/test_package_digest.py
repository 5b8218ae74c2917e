"""Installed plug-ins by the digest of their code: what counts, what does not, and how much is looked at."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.base import package_digest
from drivers.base.package_digest import digest_of

FILES = {"brought/__init__.py": "", "brought/laws/__init__.py": "", "brought/laws/lqr.py": "K = 1\n"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where packages are installed; nothing of it is imported."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    digest_of.cache_clear()
    yield tmp_path
    digest_of.cache_clear()


def digest(module: str = "brought.laws.lqr") -> str:
    digest_of.cache_clear()
    return digest_of(module)


def test_every_source_file_of_the_package_counts_and_nothing_else(folder: Path) -> None:
    first = digest()
    assert len(first) == 64
    (folder / "brought/data.csv").write_text("1,2\n")
    (folder / "brought/__pycache__").mkdir()
    (folder / "brought/__pycache__/x.py").write_text("")
    (folder / "other.py").write_text("")
    assert digest() == first
    seen = {first}
    for name in ("brought/__init__.py", "brought/laws/lqr.py", "brought/help.py", "brought/fast.abi3.so"):
        (folder / name).write_text("changed\n")
        assert digest() not in seen
        seen.add(digest())
    (folder / "brought/help.py").rename(folder / "brought/helped.py")
    assert digest() not in seen
    assert digest() == digest("brought") == digest("brought.laws")


def test_a_module_outside_packages_counts_alone(folder: Path) -> None:
    (folder / "alone_of_test.py").write_text("K = 1\n")
    first = digest("alone_of_test")
    (folder / "brought/laws/lqr.py").write_text("K = 2\n")
    assert digest("alone_of_test") == first
    (folder / "alone_of_test.py").write_text("K = 3\n")
    assert digest("alone_of_test") not in ("", first)


def test_a_folder_that_many_packages_share_is_none_of_them(folder: Path) -> None:
    (folder / "brought/__init__.py").unlink()
    first = digest()
    (folder / "brought/other.py").write_text("")
    assert digest() == first
    (folder / "brought/laws/other.py").write_text("")
    assert digest() != first


@pytest.mark.parametrize(("bound", "value"), [("MOST_FILES", 3), ("MOST_ENTRIES", 4), ("MOST_BYTES", 6)])
def test_of_a_package_that_is_too_large_the_part_around_the_module_counts(
    folder: Path, monkeypatch: pytest.MonkeyPatch, bound: str, value: int
) -> None:
    monkeypatch.setattr(package_digest, bound, value)
    for name in ("one", "two", "three"):
        (folder / f"brought/{name}.py").write_text("7654321")
    first = digest()
    (folder / "brought/one.py").write_text("1234567")
    assert digest() == first
    (folder / "brought/laws/lqr.py").write_text("K = 2\n")
    assert digest() != first


def test_of_a_module_in_a_folder_that_is_too_large_its_own_file_counts(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(package_digest, "MOST_FILES", 0)
    module, package = digest(), digest("brought.laws")
    (folder / "brought/laws/other.py").write_text("")
    assert (digest(), digest("brought.laws")) == (module, package)
    (folder / "brought/laws/lqr.py").write_text("K = 2\n")
    (folder / "brought/laws/__init__.py").write_text("K = 2\n")
    assert digest() not in ("", module)
    assert digest("brought.laws") not in ("", package)


@pytest.mark.parametrize("name", ["", ".", "no_such_module", "sys", "sys.x"])
def test_what_has_no_file_has_no_digest(folder: Path, name: str) -> None:
    assert digest(name) == ""
