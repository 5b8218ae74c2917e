"""A rig that runs on this machine as a rig file, for commands that read one and find none of its name."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from drivers.base.toml_file import toml_text
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import nearest
from hil.rig.brought import code_of
from hil.rig.provenance import rig_of_run
from hil.rig.schema import RigError


@contextlib.contextmanager
def running_rig_file(name: str) -> Iterator[Path | None]:
    """The running rig of that name, a demo's first, as it runs: a rig file with the files it names, as long as the
    context is open. None where no such rig runs. Raises RigError for one that brings code of its own.
    """
    metadata = _metadata(name)
    if metadata is None:
        yield None
        return
    if brought := code_of(metadata["rig"]):
        raise RigError([f"{name} runs, and brings {brought[0]}: name its rig file instead"])
    with rig_of_run(metadata) as (rig, folder):
        file = folder / f"{name}.toml"
        file.write_text(toml_text(rig.model_dump(mode="json")), encoding="utf-8")
        yield file


def _metadata(name: str) -> dict[str, Any] | None:
    def described(directory: Path) -> dict[str, Any]:
        with RingReader(directory / "ring") as reader:
            if not reader.writer_alive:
                raise RingError("its control process has ended")
            return reader.metadata

    with contextlib.suppress(RingError):
        return nearest(name, described, RingError)
    return None
