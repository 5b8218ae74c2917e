"""Where images come from, by the words of --source."""

from pathlib import Path

from hil.camera.contract import CameraError, Source
from hil.rig.schema import RigConfig

KINDS = {
    "drawn": "drawn: of an emulated rig (hil emulate RIG --camera)",
    "folder": "folder:PATH: image files in the order of their names",
    "opencv": "opencv:NUMBER or opencv:FILE: a camera or film, by OpenCV",
    "micro-manager": "micro-manager:FILE.cfg: the camera of that configuration, by pymmcore-plus",
}


def open_source(words: str, rig: RigConfig) -> Source:
    """Raises CameraError."""
    kind, _, rest = words.partition(":")
    if kind == "drawn" and not rest:
        from hil.camera.sources.drawn import Drawn

        return Drawn(rig)
    if kind == "folder" and rest:
        from hil.camera.sources.folder import Folder

        return Folder(Path(rest))
    if kind == "opencv" and rest:
        from hil.camera.sources.latest import Latest
        from hil.camera.sources.opencv import OpenCv

        images = OpenCv(rest)
        return Latest(images) if images.is_camera else images
    if kind == "micro-manager" and rest:
        from hil.camera.sources.micro_manager import MicroManager

        return MicroManager(rest)
    raise CameraError(f"--source {words!r:.80}: expected {'; '.join(KINDS.values())}")
