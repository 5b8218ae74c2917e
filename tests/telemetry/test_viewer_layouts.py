"""The shipped layouts for MCAP viewers: up to date, and all they name is in a recording."""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import hil
from docs.make_pages import VIEWERS, viewer_files
from hil.telemetry.viewer_layouts import paths


@pytest.mark.parametrize("path", sorted(viewer_files()), ids=lambda path: path.name)
def test_the_shipped_layouts_are_up_to_date(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == viewer_files()[path], "run `make docs`"


def named(rig: str) -> tuple[set[str], set[str]]:
    """Every path in the two layouts of a rig, as topic.field.field."""
    document = json.loads((VIEWERS / f"{rig}.lichtblick.json").read_text())
    shown: list = [document["layout"]]
    panels = set()
    while shown:
        part = shown.pop()
        if isinstance(part, str):
            panels.add(part)
        else:
            shown += [part["first"], part["second"]]
    assert panels == set(document["configById"])  # every plot has its place
    lichtblick = {line["value"] for config in document["configById"].values() for line in config["paths"]}
    root = ElementTree.parse(VIEWERS / f"{rig}.plotjuggler.xml").getroot()
    return lichtblick, {curve.attrib["name"].replace("/", ".") for curve in root.iter("curve")}


@pytest.mark.parametrize("rig", ["microscope", "paper"])
def test_every_path_named_in_a_layout_exists_in_a_recording_and_moves_or_is_a_number(rig: str, tmp_path: Path) -> None:
    hil.simulate(rig, 0.3, record=tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        [*_, (_, _, _, message)] = reader.iter_decoded_messages(topics=["tick"])
    axes = list(hil.load_rig(rig).axes)
    for layout in named(rig):
        assert layout == {f"tick.{path}" for path in paths(axes)}
        for path in layout:
            value = message
            for field in path.split(".")[1:]:
                assert field in value.DESCRIPTOR.fields_by_name, path
                value = getattr(value, field)
            assert isinstance(value, int | float), path
