"""docs/answers.md: what is believed of an answer, made from layouts, fault rows and the campaign's trials."""

from collections.abc import Iterator
from pathlib import Path

from drivers.config import BusConfig
from drivers.protocols import host_protocol
from drivers.protocols.answer_fields import Field, bounds_of
from drivers.protocols.base import HostProtocol
from hil.cycle.fault_table import ROWS
from hil.rig.file import load_rig
from hil.rig.layout import host_layout
from hil.studies.fault_campaign.answer_fields import Pattern, result_of
from hil.studies.fault_campaign.catalogue import TRIALS
from hil.studies.fault_campaign.layout_capabilities import fixed_capabilities

RIGS = Path(__file__).parent.parent / "deploy" / "rigs"
OWN = ("stage_fd", "stage_classic", "cia402", "moteus", "mit")
BOUND = {
    "dbc, as `odrive.toml` binds it": "odrive",
    "dbc, as `vesc.toml` does": "vesc",
    "dbc, as `paper-dbc.toml` does": "paper-dbc",
}
HEAD = """# What is believed of an answer

Made by `make docs` from `drivers/protocols/answer_fields.py` (the bounds), the rows in `hil/cycle/faults/` (the faults)
and `hil/studies/fault_campaign/answer_fields.py` (the cells). A cell says what comes of a field that is wrong so long.
`hil faults RIG --only field:` tries them at rest and in motion, on every axis. *Rejected* means: not used, counted,
and nothing latches; while axes may move, the gap is told in the same tick. Ticks count from the first wrong answer, or
from the last one that a limit in `[safety]` permits: `bad_frame_limit` frames for bad_frames, `silent_stop_ticks` for
encoder_lost, `silent_zero_ticks` for encoder_dead, the second answer for answers_differ.
A drive whose state comes in a message of its own is seen later by that message's period."""


def answers_page() -> str:
    """The page."""
    lines = [HEAD, "", "## Which fault says so", "", "| field | faults |", "|---|---|"]
    lines += [f"| {field.value} | {', '.join(_told_by(field))} |" for field in Field]
    for name, layout in _layouts():
        lines += ["", f"## {name}", "", *_table(layout)]
    return "\n".join(lines) + "\n"


def _told_by(field: Field) -> list[str]:
    return [fault.name.lower() for fault, row in ROWS.items() if field in row.guards]


def _layouts() -> Iterator[tuple[str, HostProtocol]]:
    for name in OWN:
        yield name, host_protocol(BusConfig(protocol=name), 1, [1.0], RIGS)
    for name, rig in BOUND.items():
        yield name, host_layout(load_rig(RIGS / f"{rig}.toml"), RIGS)


def _table(layout: HostProtocol) -> list[str]:
    capabilities = fixed_capabilities(layout)
    heads = ["field", "bound", "outside it", *(pattern.value for pattern in Pattern)]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for field, bound in bounds_of(layout).items():
        cells = [result_of(field, pattern, TRIALS, capabilities) for pattern in Pattern]
        lines.append(f"| {' | '.join([field.value, bound.bound, bound.outside, *cells])} |")
    return lines
