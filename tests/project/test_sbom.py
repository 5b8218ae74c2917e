"""The wheel's bill of materials: what the wheel needs, as the lock pins it, and nothing else."""

import json
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

from deploy.debian.runtime_lock import blocks, normal
from deploy.wheel.sbom import FILE, text
from tests.support.paths import ROOT

BILL = json.loads(FILE.read_text(encoding="utf-8"))
COMPONENTS = {one["name"]: one for one in BILL["components"]}


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="the list is made on Python 3.11, as the lock is")
def test_it_is_up_to_date() -> None:
    assert FILE.read_text(encoding="utf-8") == text(), "python -m deploy.wheel.sbom"


def test_every_component_is_pinned_and_has_a_licence() -> None:
    pinned = blocks((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    for name, one in COMPONENTS.items():
        assert pinned[name].startswith(f"{one['name']}=={one['version']} "), name
        assert one["purl"] == f"pkg:pypi/{name}@{one['version']}"
        assert one["licenses"], name


def test_it_has_what_the_wheel_declares_and_what_that_needs_and_no_test_tool() -> None:
    declared = {
        normal(text.partition(">")[0].strip()) for text in metadata.requires("hil") or [] if "extra ==" not in text
    }
    assert declared <= set(COMPONENTS)
    edges = {one["ref"]: one["dependsOn"] for one in BILL["dependencies"]}
    reached, todo = set(), [BILL["metadata"]["component"]["bom-ref"]]
    while todo:
        reference = todo.pop()
        todo += [one for one in edges[reference] if one not in reached]
        reached.add(reference)
    assert reached == set(edges)
    assert reached == {one["purl"] for one in (BILL["metadata"]["component"], *COMPONENTS.values())}
    assert not {"pytest", "mypy", "ruff", "hatchling"} & set(COMPONENTS)


def test_the_wheel_carries_it(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path], cwd=ROOT, check=True)
    (wheel,) = tmp_path.glob("hil-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if "/sboms/" in name)
        assert json.loads(archive.read(name)) == BILL
        about = archive.read(f"{name.partition('/')[0]}/METADATA").decode()
    assert "License-Expression: MIT" in about
