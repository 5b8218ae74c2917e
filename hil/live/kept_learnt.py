"""What the law of a live run has learnt begins the next run of that rig.

One file a rig, as of `hil learnt`, in the user's state folder, written when the control process has ended. An emulated
stage on the local bus is another stage: its file is in the runtime directory, as all else of it. An axis whose stage,
law or rate is another than that it was learnt on begins without. Where the rig file names a state to begin with, what
runs have learnt since they began with that one takes its place; another one named takes the place of both.
"""

import importlib.metadata
from collections.abc import Sequence
from pathlib import Path

from drivers.base.runtime import state_folder, write_private
from drivers.bus.port import resolve_interface
from hil.control.law_registry import is_built_in, law_class
from hil.live.runtime_paths import runtime_paths
from hil.rig.file import document_hash, learning_hash, learning_hashes
from hil.rig.learnt_file import LearntFileError, begun_with, learnt_text, read_states
from hil.rig.schema import RigConfig


def kept_path(rig: RigConfig) -> Path:
    """Where it is kept."""
    if resolve_interface(rig.bus) == "local":
        return runtime_paths(rig.name).directory / "learnt.json"
    return state_folder() / "learnt" / f"{rig.name}.json"


def with_kept(rig: RigConfig, *, fresh: bool) -> tuple[RigConfig, str]:
    """The rig that begins with what is kept of it, else with what its file names, and keeps what it learns; and a line
    that says so. It stays as it was, without a line, where its law keeps nothing.

    fresh: begin with nothing that earlier runs have learnt.
    """
    law = rig.law
    if not is_built_in(law) or not law_class(law).learns_repeats:
        return rig, ""
    path, states, line = kept_path(rig), dict[str, list[float]](), f"begins with {law.learnt}" if law.learnt else ""
    named = law.learnt_state if law.learnt else [[] for _ in rig.axes]
    origin = document_hash({"state": named}) if law.learnt else ""
    if not fresh and path.exists():
        try:
            if not origin or begun_with(path) == origin:
                states = read_states(path, _hashes(rig))
                line = _line(rig, path, states)
        except LearntFileError as error:
            line = f"{error}; {line or 'nothing learnt is used'}"
    state = [states.get(name, own) for name, own in zip(rig.axis_names, named, strict=True)]
    kept = law.model_copy(update={"learnt": "", "learnt_on": origin, "learnt_state": state})
    return rig.model_copy(update={"law": kept}), line


def keep(rig: RigConfig, states: Sequence[Sequence[float]]) -> Path | None:
    """Keep what the law begins its next run with, by axis; those that have learnt nothing leave none. Where it is kept,
    None where there is nothing. Raises OSError.
    """
    state = {name: list(values) for name, values in zip(rig.axis_names, states, strict=False) if values}
    if not state:
        return None
    path = kept_path(rig)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_private(path, learnt_text(rig.name, learning_hash(rig), _hashes(rig), state, rig.law.learnt_on))
    return path


def _hashes(rig: RigConfig) -> dict[str, str]:
    """By axis, what a state serves: the stage, and the version that knows what its numbers mean."""
    version = importlib.metadata.version("hil")
    return {name: f"{digest}/{version}" for name, digest in learning_hashes(rig).items()}


def _line(rig: RigConfig, path: Path, states: dict[str, list[float]]) -> str:
    others = [name for name in rig.axis_names if name not in states]
    begun = f"begins with what earlier runs have learnt of {', '.join(states)} ({path})" if states else ""
    refused = f"{', '.join(others)}: not with what {path} has, which was learnt on another stage, law or version"
    return "; ".join(part for part in (begun, refused if others else "") if part)
