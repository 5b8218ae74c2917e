"""Pages of docs/ made from the tables in code: `python -m docs.make_pages`. A test holds them up to date."""

import inspect
import json
import re
import sys
from collections import defaultdict
from functools import cached_property
from pathlib import Path
from typing import Any, cast, get_args

import hil
from docs.answers_page import answers_page
from docs.safety_case_page import safety_case_page
from drivers.config import LAYOUTS, BusConfig
from drivers.protocols import host_protocol
from hil.control.gain import Gain, Knob, declared
from hil.control.law_registry import law_class
from hil.control.laws.iterative_learning import LEARNING_GAINS
from hil.cycle.fault_table import ROWS, Reaction
from hil.cycle.state_machine import SILENT_STATES, TABLE, TORQUE_STATES, Event, State
from hil.events.table import KINDS
from hil.rig.file import load_rig
from hil.rig.law_names import LAWS
from hil.rig.reference import WRITTEN, Table, as_json, in_schema, json_schema, tables
from hil.rig.schema import LawConfig
from hil.studies.fault_campaign.layout_capabilities import TEXTS, Capability, fixed_capabilities
from hil.telemetry.viewer_layouts import lichtblick, plotjuggler

FOLDER = Path(__file__).parent.parent / "docs"
SCHEMA = FOLDER.parent / "deploy" / "rigs" / "rig.schema.json"
VIEWERS = FOLDER.parent / "deploy" / "viewers"
REACTION_TEXT = {
    Reaction.COUNT: "R0 count",
    Reaction.BRIDGE: "R1 bridge on the prediction, at most 2 ticks",
    Reaction.STOP: "R2 damped stop, then zero, latch",
    Reaction.ZERO: "R3 zero and disable now, latch",
    Reaction.SILENT: "R4 as R3, and send nothing more",
}


GAINS_BEGIN = "<!-- gains: made by `make docs` from Law.GAINS -->"
GAINS_END = "<!-- end of gains -->"


def states_page() -> str:
    """docs/states.md."""
    lines = [
        "# States",
        "",
        "Made from `hil/cycle/state_machine.py` by `make docs`.",
        "",
        "![states](pictures/states.svg)",
        "",
    ]
    lines += ["| state | torque | sends | " + " | ".join(event.name for event in Event) + " |"]
    lines += ["|---" * (len(Event) + 3) + "|"]
    for state in State:
        cells = [TABLE[state, event].name if (state, event) in TABLE else "" for event in Event]
        torque = "yes" if state in TORQUE_STATES else "zero"
        sends = "nothing" if state in SILENT_STATES else "every tick"
        lines.append(f"| **{state.name}** | {torque} | {sends} | " + " | ".join(cells) + " |")
    lines += ["", "An empty cell is an illegal event: refused, counted, without effect."]
    return "\n".join(lines) + "\n"


def faults_page() -> str:
    """docs/faults.md."""
    lines = [
        "# Faults",
        "",
        "Made from the rows in `hil/cycle/faults/` by `make docs`. Thresholds are keys of `[safety]` in the rig file.",
        "",
        "WITHDRAW takes the place of R2 where the tip of a motion is beyond its safe height: the tip goes there first.",
        "Then R2 follows. [Inject cells](inject.md#when-the-rig-stops) says when.",
        "",
    ]
    lines += ["| number | fault | seen by | after | reaction | armed in |", "|---|---|---|---|---|---|"]
    for fault, rule in ROWS.items():
        armed = ", ".join(state.name for state in State if state in rule.states)
        lines.append(
            f"| {fault.value} | {fault.name.lower()} | {rule.seen_by} | {rule.after} "
            f"| {REACTION_TEXT[rule.reaction]} | {armed} |"
        )
    return "\n".join([*lines, *_advice_lines(), *_kind_lines(), *_capability_lines()]) + "\n"


def _kind_lines() -> list[str]:
    """Every kind of event, and where events are told."""
    lines = ["", "## Events", ""]
    lines += [
        "Whatever happens is told with tick, time, axis, measured value, limit, cause and what to do next:",
        "`journalctl -u 'hil-*@NAME.service'` and `hil events NAME` at the rig; `hil events RUN`, summary.json, the",
        "marks of tracking.png and the topic `events` of the recording afterwards; on Zenoh the key `KEY/RIG/events`,",
        "published as it happens, and queried by whoever joins late (message `Events`, hil/telemetry/events.proto).",
        "",
        "| kind | it says | measured | usual cause | what to do next |",
        "|---|---|---|---|---|",
    ]
    for kind, text in KINDS.items():
        measured = f"{text.measured}, {text.unit}" if text.unit else text.measured
        cells = (kind.name, text.text, measured, text.cause, text.action)
        lines.append("| " + " | ".join(cell or "its own" for cell in cells) + " |")
    return lines


def _advice_lines() -> list[str]:
    """What an event says of each fault: measured, usual cause, what to do next."""
    lines = ["", "## What to do", ""]
    lines += ["Made from the rows in `hil/cycle/faults/`; every event of a fault carries the same words.", ""]
    lines += ["| fault | measured | unit | usual cause | what to do next |", "|---|---|---|---|---|"]
    for fault, text in ROWS.items():
        measured = text.measured.format(" / ".join(text.words)) if text.words else text.measured
        lines.append(f"| {fault.name.lower()} | {measured} | {text.unit} | {text.cause} | {text.action} |")
    return lines


def _capability_lines() -> list[str]:
    """What a layout cannot tell, from the properties the campaign goes by."""
    has = {
        name: fixed_capabilities(host_protocol(BusConfig(protocol=name), 1, [1.0], FOLDER))
        for name in LAYOUTS
        if ":" not in name
    }
    lines = ["", "## What a layout cannot tell", ""]
    lines += [
        "Made from `hil/studies/fault_campaign/layout_capabilities.py`. Where a layout lacks one of these, `hil "
        "faults` demands less, counts the cells (`cannot tell`) and says why. A DBC file has what it binds.",
        "",
    ]
    lines += ["| what it takes | " + " | ".join(has) + " | without it |", "|---" * (len(has) + 2) + "|"]
    for capability, text in TEXTS.items():
        marks = [
            "as its load leaves" if capability is Capability.ROOM else "yes" if capability & own else "no"
            for own in has.values()
        ]
        lines.append(f"| {text.capability} | {' | '.join(marks)} | {text.follows} |")
    return lines


def rig_file_page() -> str:
    """docs/rig-file.md."""
    lines = [
        "# The rig file",
        "",
        "Made from the schema (`hil/rig/schema.py`) by `make docs`. `hil explain KEY` prints the same for one key; "
        "editors that know JSON schemas complete and check rig files by `deploy/rigs/rig.schema.json`. NAME stands for "
        "an axis' name. Units are SI; where an axis is rotary, the unit in brackets holds. A key that is not required "
        "has its default; where that is another key, it is that key's value.",
    ]
    alike: dict[tuple[str, ...], list[Table]] = defaultdict(list)
    for table in tables():  # the signals of [bus.dbc] are all of one kind
        alike[table.description, *(key.path.rpartition(".")[2] for key in table.keys)].append(table)
    for group in alike.values():
        lines += ["", f"## {', '.join(f'`[{table.path}]`' for table in group if table.path) or 'The file'}", ""]
        lines += [group[0].description.partition("]: ")[2] or group[0].description, ""]
        lines += ["| key | type | unit | allowed | default | meaning |", "|---|---|---|---|---|---|"]
        for key in group[0].keys:
            allowed, meaning = (text.replace("|", "\\|") for text in (key.allowed, key.description))
            lines.append(
                f"| `{key.path.rpartition('.')[2]}` | {key.kind} | {key.unit} | {allowed} | {key.default} | {meaning} |"
            )
    return "\n".join(lines) + "\n"


def rig_schema() -> str:
    """deploy/rigs/rig.schema.json."""
    return json.dumps(json_schema(), indent=1) + "\n"


def gains_table() -> str:
    """The gains of every law, as docs/laws.md has them between its two markers."""
    lines = ["| law | gain | default | unit | range | searched by `hil tune` | meaning |", "|---" * 7 + "|"]
    for name in LAWS:
        for key, gain in declared(law_class(LawConfig(name=name)).GAINS).items():
            lines.append(_gain_row(name, key, gain))
    lines += [_gain_row("any, learning", key, gain) for key, gain in LEARNING_GAINS.items()]
    return "\n".join(lines) + "\n"


def _gain_row(law: str, key: str, gain: Gain) -> str:
    default = "from the rig" if gain.default is None else str(gain.default)
    allowed = ", ".join(gain.words) if gain.words else gain.allowed().removeprefix("a ").replace("finite number ", "")
    ranges = [_knob(knob) + note for knob, note in ((gain.tune, ""), (gain.plan, " (injection plan)")) if knob]
    cells = (law, f"`{key}`", default, gain.unit, allowed, "; ".join(ranges), gain.meaning)
    return "| " + " | ".join(cell.replace("|", "&#124;") for cell in cells) + " |"


def _knob(knob: Knob) -> str:
    unit = " ".join(part for part in ("" if knob.scale == "1" else knob.scale, knob.of and f"`{knob.of}`") if part)
    return f"{knob.low:g} to {knob.high:g}" + (f" × {unit}" if unit else "")


def python_page() -> str:
    """docs/python.md: what `import hil` gives, from the docstrings."""
    lines = [
        "# hil in Python",
        "",
        "Made from the docstrings by `make docs`. Programs that use it: [examples/](../examples/README.md). Library "
        "functions print nothing, end nothing and read no arguments; what is not here may change from one "
        "version to the next.",
    ]
    for name in sorted(hil.__all__):
        found = getattr(hil, name)
        lines += ["", f"## `hil.{name}`", "", *_code(name, found)]
        if inspect.isclass(found):
            for key, member in vars(found).items():
                if not key.startswith("_") and (text := inspect.getdoc(member)) and _is_own(member):
                    lines += ["", f"**`{key}{_call(member)}`** " + " ".join(text.split())]
    return "\n".join(lines) + "\n"


def _is_own(member: object) -> bool:
    return isinstance(member, property | cached_property | classmethod) or inspect.isfunction(member)


def _code(name: str, found: object) -> list[str]:
    """How it is called, with types and defaults, and the text, as it stands in the source."""
    if words := get_args(found):
        return ["One of " + ", ".join(f"`{word!r}`" for word in words) + "."]
    call = _call(found) or _call(vars(found).get("__init__")) if hasattr(found, "__dict__") else ""
    return ["```", *([name + call, ""] if call else []), *(inspect.getdoc(found) or "").splitlines(), "```"]


def _call(member: object) -> str:
    """Parameters with types and defaults, and the type of the result; nothing for what is not called."""
    if isinstance(member, property | cached_property):
        function = member.fget if isinstance(member, property) else member.func
        return ": " + _plain(inspect.formatannotation(inspect.signature(cast(Any, function)).return_annotation))
    function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
    if not inspect.isfunction(function):
        return ""
    signature = inspect.signature(function)
    parameters = [each for each in signature.parameters.values() if each.name not in ("self", "cls")]
    result = "" if function.__name__ == "__init__" else f" -> {inspect.formatannotation(signature.return_annotation)}"
    return _plain(str(signature.replace(parameters=parameters, return_annotation=inspect.Signature.empty)) + result)


def _plain(text: str) -> str:
    """Types as a program names them: hil.runs.api.Run is Run, quoted or not; long lists of literals by their name."""
    text = re.sub(r"'([A-Z]\w*)'", r"\1", text)
    literals = re.escape(str(hil.Column))
    text = re.sub(literals, "Column", text)
    text = re.sub(r"numpy\.ndarray\[tuple\[Any, \.\.\.\], numpy\.dtype\[(?:numpy\.)?(\w+)\]\]", r"NDArray[\1]", text)
    return re.sub(r"\b(?:[a-z_]\w*\.)+(?=[A-Z]\w)", "", text).replace("~", "")


def laws_page() -> str:
    """docs/laws.md with its table of gains renewed; the text around it is written by hand."""
    before, _, rest = (FOLDER / "laws.md").read_text(encoding="utf-8").partition(GAINS_BEGIN)
    _, _, after = rest.partition(GAINS_END)
    return f"{before}{GAINS_BEGIN}\n{gains_table()}{GAINS_END}{after}"


def viewer_files() -> dict[Path, str]:
    """Layouts for MCAP viewers of the shipped rigs whose axes differ, by where they are kept."""
    found = {}
    for name in ("microscope", "paper"):
        axes = list(load_rig(SCHEMA.parent / f"{name}.toml").axes)
        found[VIEWERS / f"{name}.lichtblick.json"] = lichtblick(axes)
        found[VIEWERS / f"{name}.plotjuggler.xml"] = plotjuggler(axes)
    return found


def main() -> None:
    """Write the pages."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(exist_ok=True)
    WRITTEN.write_text(as_json(in_schema()), encoding="utf-8")  # first: pages are made from it
    (folder / "states.md").write_text(states_page(), encoding="utf-8")
    (folder / "faults.md").write_text(faults_page(), encoding="utf-8")
    (folder / "answers.md").write_text(answers_page(), encoding="utf-8")
    (folder / "safety-case.md").write_text(safety_case_page(), encoding="utf-8")
    (folder / "rig-file.md").write_text(rig_file_page(), encoding="utf-8")
    SCHEMA.write_text(rig_schema(), encoding="utf-8")
    for path, text in viewer_files().items():
        path.write_text(text, encoding="utf-8")
    (folder / "laws.md").write_text(laws_page(), encoding="utf-8")
    (folder / "python.md").write_text(python_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
