"""What the law of a live run has learnt begins the next run of that rig.

One file a rig, as of `hil learnt`, in the user's state folder, written when the control process has ended. An emulated
stage on the local bus is another stage: its file is in the runtime directory, as all else of it. An axis whose stage,
law or rate is another than that it was learnt on begins without.
"""

import importlib.metadata
from collections.abc import Sequence
from pathlib import Path

from drivers.base.runtime import state_folder, write_private
from drivers.bus.port import resolve_interface
from hil.control.law_registry import is_built_in, law_class
from hil.live.runtime_paths import runtime_paths
from hil.rig.file import learning_hash, learning_hashes
from hil.rig.learnt_file import LearntFileError, learnt_text, read_states
from hil.rig.schema import RigConfig


def kept_path(rig: RigConfig) -> Path:
    """Where it is kept."""
    if resolve_interface(rig.bus) == "local":
        return runtime_paths(rig.name).directory / "learnt.json"
    return state_folder() / "learnt" / f"{rig.name}.json"


def with_kept(rig: RigConfig, *, fresh: bool) -> tuple[RigConfig, str]:
    """The rig that begins with what is kept of it and keeps what it learns, and a line that says so.

    It stays as it was, without a line, where its law keeps nothing or the rig file says what to begin with.
    fresh: begin with nothing.
    """
    law = rig.law
    if law.learnt or not is_built_in(law) or not law_class(law).learns_repeats:
        return rig, ""
    path, states, line = kept_path(rig), dict[str, list[float]](), ""
    if not fresh and path.exists():
        try:
            states = read_states(path, _hashes(rig))
            line = _line(rig, path, states)
        except LearntFileError as error:
            line = f"{error}; nothing learnt is used"
    state = [states.get(name, []) for name in rig.axis_names]
    kept = law.model_copy(update={"learnt_on": learning_hash(rig), "learnt_state": state})
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
    write_private(path, learnt_text(rig.name, learning_hash(rig), _hashes(rig), state))
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
