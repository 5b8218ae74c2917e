"""Every command of `hil`, in words that end soon. `{in}` is the folder of what they read; they run in one of their own.

`makes`: files that must be there, and not empty, where the command says that all is well.
"""

from typing import NamedTuple


class Case(NamedTuple):
    """words: after `hil`. makes: files it writes. status: how it ends undisturbed. ends: s until a SIGTERM ends it;
    None where it ends by itself.
    """

    words: tuple[str, ...]
    makes: tuple[str, ...] = ()
    status: int = 0
    ends: float | None = None


def _case(words: str, *makes: str, status: int = 0, ends: float | None = None) -> Case:
    return Case(tuple(words.split()), makes, status, ends)


CASES = {
    "accuracy": _case("accuracy {in}/rig.toml --axes x --runs 2 --out a.csv --json a.json", "a.csv", "a.json"),
    "baseline": _case("baseline {in}/run --json b.json"),
    "bench bus": _case("bench bus {in}/rig.toml --seconds 0.1 --json b.json", "b.json", status=1),
    "bench jitter": _case("bench jitter {in}/rig.toml --blocks 1 --ticks 100 --no-telemetry --json j.json", "j.json"),
    "blackbox": _case("blackbox {in}/rig.toml --out box"),
    "bus play": _case("bus play {in}/trace.log --channel hostile -i local"),
    "bus record": _case("bus record r.log --channel hostile -i local --seconds 0.2"),
    "bus view": _case("bus view --channel hostile -i local --seconds 0.2"),
    "camera": _case("camera {in}/rig.toml --source drawn", status=78),
    "check": _case("check {in}/rig.toml --json c.json --picture c.png --frd f.json", "c.json", "c.png", "f.json"),
    "command": _case("command {in}/rig.toml stop", status=69),
    "compare": _case("compare {in}/rig.toml --laws pid --seconds 1 --picture c.png --json c.json --workers 1",
                     "c.png", "c.json"),
    "demo": _case("demo {in}/rig.toml --virtual --seconds 0.5 --out d", "d/run.mcap"),
    "diff": _case("diff {in}/run {in}/other --json d.json", "d.json"),
    "doctor": _case("doctor"),
    "drive": _case("drive {in}/drive.eds -c hostile -i local --seconds 0.2"),
    "drives": _case("drives --eds {in}/drive.eds --json d.json", "d.json"),
    "emulate": _case("emulate {in}/rig.toml --status s.json", "s.json", ends=2.0),
    "estop": _case("estop paper", status=69),
    "events": _case("events {in}/run"),
    "evidence": _case("evidence {in}/rig.toml --stages 2 --modes 0 --axes x --trials rest --workers 1",
                      status=-15, ends=3.0),
    "explain": _case("explain safety"),
    "export": _case("export {in}/run --out e.csv", "e.csv"),
    "faults": _case("faults {in}/rig.toml --only interface --stride 16 --workers 1 --json f.json --html f.html",
                    "f.json", "f.html"),
    "home": _case("home paper", status=69),
    "identify": _case("identify {in}/rig.toml --axes x --only push --write i.toml --json i.json", "i.toml", "i.json"),
    "inject": _case("inject {in}/cells.toml --grid 1x1 --csv i.csv --report i.html --json i.json",
                    "i.csv", "i.html", "i.json"),
    "install": _case("install --rig {in}/rig.toml --root r --channel vcan9"),
    "jog": _case("jog paper x=1mm/s", status=69),
    "learnt": _case("learnt {in}/learning/run.mcap --out l.json"),
    "monitor": _case("monitor paper --once", status=69),
    "move": _case("move paper x=1mm", status=69),
    "new": _case("new n.toml", "n.toml"),
    "page": _case("page --port 15006 --runs {in}", status=-15, ends=2.0),
    "page --paired": _case("page --paired"),
    "plot": _case("plot {in}/run --out p.png", "p.png"),
    "recover": _case("recover {in}/cut.mcap --out r.mcap", "r.mcap", status=1),
    "replay": _case("replay {in}/run/run.mcap --json r.json", "r.json"),
    "report": _case("report {in}/run --out r.html", "r.html"),
    "reproduce": _case("reproduce --claims pdff-exact --out r --workers 1", "r/report.html"),
    "rigs": _case("rigs --json -"),
    "run": _case("run {in}/rig.toml --ticks 200 --set timing.allow_degraded=true"),
    "runs": _case("runs --in {in}"),
    "runs disk": _case("runs disk --in {in}"),
    "runs note": _case("runs note {in}/run noted"),
    "runs trend": _case("runs trend --in {in}"),
    "share": _case("share {in}/run --out s.zip", "s.zip"),
    "sidecar": _case("sidecar {in}/rig.toml --out s --or-free-port", ends=3.0),
    "sim": _case("sim {in}/rig.toml --seconds 0.5 --record s.mcap --json s.json --picture s.png",
                 "s.mcap", "s.json", "s.png"),
    "sim --keep": _case("sim {in}/rig.toml --seconds 0.5 --out s", "s/run.mcap"),
    "stream": _case("stream paper {in}/rows.csv", status=69),
    "sweep": _case("sweep {in}/rig.toml --plants 4 --seconds 9 --workers 1 --worst 1 --json w.json", "w.json"),
    "tune": _case("tune {in}/small.toml --population 5 --generations 1 --unseen 1 --trials task --dry-run",
                  status=-15, ends=3.0),
    "uninstall": _case("uninstall --root {in}/nothing"),
}  # fmt: skip
