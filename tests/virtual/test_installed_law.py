"""A law of an installed package is named by its code: in the rig's hash, the recording, and whatever replays it."""

import importlib.metadata
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import hil
from drivers.base import plugins
from drivers.base.package_digest import digest_of
from hil.rig.file import build_rig, load_rig, rig_hash
from hil.rig.schema import RigError
from hil.runs.api import Recording, simulate
from tests.support.paths import RIGS, ROOT

NAMES = ["brought.lqr:Lqr", "of-a-package"]  # by module and class, and by entry point
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An installed package with a law, and a module beside it that the law might import."""
    folder = tmp_path / "site/brought"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "help.py").write_text("")
    shutil.copy(ROOT / "examples/laws/lqr.py", folder)
    monkeypatch.syspath_prepend(folder.parent)
    entry = importlib.metadata.EntryPoint("of-a-package", "brought.lqr:Lqr [extra]", "hil.laws")
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "hil.laws" else [])
    digest_of.cache_clear()
    yield folder
    digest_of.cache_clear()
    for name in [name for name in sys.modules if name.split(".")[0] == "brought"]:
        del sys.modules[name]


def changed(package: Path) -> None:
    """As after an upgrade of the package, in another process."""
    (package / "help.py").write_text("K = 2\n")
    digest_of.cache_clear()


@pytest.mark.parametrize("name", NAMES)
def test_the_packages_code_is_part_of_the_rigs_hash(name: str, package: Path) -> None:
    rig = load_rig(RIGS / "paper.toml", [f"law.name={name}"])
    assert rig.law.source == plugins.DIGEST + digest_of("brought.lqr")
    assert rig_hash(build_rig(rig.model_dump(mode="json"))) == rig_hash(rig)
    changed(package)
    other = load_rig(RIGS / "paper.toml", [f"law.name={name}"])
    assert rig_hash(other) != rig_hash(rig)
    assert rig_hash(build_rig(rig.model_dump(mode="json"))) == rig_hash(rig)


def test_a_recording_is_not_replayed_through_another_version(package: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    run = simulate(RIGS / "paper.toml", 0.25, overrides=["law.name=of-a-package", *QUICK], record=path)
    assert hil.replay(path, run_its_code=True).different == 0
    assert not Recording(path).exact  # which would run it
    assert Recording(path).metadata["rig"]["law"]["source"] == run.rig.law.source
    changed(package)
    with pytest.raises(RigError, match=r"law\.name = 'of-a-package': the installed package is another than this rig's"):
        hil.replay(path, run_its_code=True)
    assert len(Recording(path).time) == 250  # its columns can be looked at all the same
