"""The wheel's software bill of materials, in CycloneDX 1.6: `python -m deploy.wheel.sbom`, run by `make lock`.

The wheel holds no code of others; this lists what it needs to run, as requirements.lock pins it for this Python, with
each package's licence. Source of the form: cyclonedx.org, specification 1.6; PEP 770 says where a wheel keeps it.
"""

import json
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from deploy.debian.runtime_lock import blocks, closure, normal

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_name("sbom.cdx.json")  # pyproject.toml names it


def licences(name: str) -> list[dict[str, Any]]:
    """A package's licence: its SPDX expression where it states one, else the name it gives."""
    about = metadata.metadata(name)
    if expression := about.get("License-Expression"):
        return [{"expression": expression}]
    classified = [one.rpartition(" :: ")[2] for one in about.get_all("Classifier", []) if one.startswith("License :: ")]
    stated = (about.get("License") or "").strip().splitlines()[:1]
    return [{"license": {"name": one}} for one in classified or stated]


def _component(name: str, pinned: dict[str, str]) -> dict[str, Any]:
    version = pinned[name].partition("==")[2].split()[0]
    url = f"pkg:pypi/{name}@{version}"
    return {
        "type": "library",
        "bom-ref": url,
        "name": name,
        "version": version,
        "licenses": licences(name),
        "purl": url,
    }


def _needs(name: str, among: set[str]) -> list[str]:
    """Which of them a package names as its own requirements."""
    named = {normal(Requirement(text).name) for text in metadata.requires(name) or []}
    return sorted(named & among)


def bill() -> dict[str, Any]:
    """The document. Raises KeyError where requirements.lock lacks a package."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pinned = blocks((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    names = sorted(closure("hil", frozenset()) - {"hil"})
    components = {name: _component(name, pinned) for name in names}
    own = f"pkg:pypi/hil@{project['version']}"
    subject = {
        "type": "application",
        "bom-ref": own,
        "name": "hil",
        "version": project["version"],
        "description": project["description"],
        "licenses": [{"expression": project["license"]}],
        "purl": own,
    }
    references = {name: component["bom-ref"] for name, component in components.items()}
    edges = {own: _needs("hil", set(names)), **{references[name]: _needs(name, set(names)) for name in names}}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": subject},
        "components": list(components.values()),
        "dependencies": [
            {"ref": reference, "dependsOn": [references[name] for name in needed]}
            for reference, needed in edges.items()
        ],
    }


def text() -> str:
    """The file as it should be."""
    return json.dumps(bill(), indent=1) + "\n"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
    sys.stdout.write(f"{FILE}\n")
