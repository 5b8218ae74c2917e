"""A rig file is right, or it is refused whole, with every problem named, before a bus is opened."""

import copy
import math
import os
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base.toml_file import LARGEST, MOST_PROBLEMS
from hil.cli.exit_status import EXIT_CONFIG
from hil.rig.file import build_rig, load_rig, rig_hash
from hil.rig.schema import RigConfig, RigError, TaskConfig
from tests.support.paths import RIGS

PAPER = RIGS / "paper.toml"
SCRIPTABLE = {
    "rate_hz": "500",
    "law.name": "pd-feedforward",
    "law.gains.kp": "[1.0, 2.0]",
    "plant.mass_scale": "1.2",
    "plant.friction_scale": "0.7",
    "plant.modelling_error": "0.3",
    "plant.encoder_resolution": "5e-9",
    "plant.ripple_amplitude": "0.05",
    "plant.ripple_period": "0.05",
    "plant.stribeck_scale": "0.2",
    "plant.stribeck_velocity": "0.01",
    "plant.seed": "7",
    "wire.drop_probability": "0.01",
    "wire.jitter": "5e-5",
    "task.kind": "lissajous",
    "task.radius": "0.01",
    "task.frequency_hz": "0.25",
    "task.phase": "0.3",
    "task.approach_s": "1.0",
}


@pytest.mark.parametrize("name", ["paper.toml", "microscope.toml"])
def test_the_rigs_we_ship_are_valid(name: str) -> None:
    assert load_rig(RIGS / name).name == name.removesuffix(".toml")


@pytest.mark.parametrize("key", SCRIPTABLE)
def test_every_scriptable_key_can_be_set(key: str) -> None:
    value: Any = load_rig(PAPER, [f"{key}={SCRIPTABLE[key]}"]).model_dump()
    for part in key.split("."):
        value = value[part]
    text = SCRIPTABLE[key]
    assert value == (text if part in ("name", "kind") else tomllib.loads(f"v = {text}")["v"])


def test_modelling_error_takes_one_number_or_one_per_axis() -> None:
    assert load_rig(PAPER, ["plant.modelling_error=0.3"]).plant.modelling_error == 0.3
    assert load_rig(PAPER, ["plant.modelling_error=[0.3, 0.1]"]).plant.modelling_error == [0.3, 0.1]


def test_a_whole_table_can_be_set() -> None:
    table = TaskConfig(kind="point_to_point", axes=["y"], target=[0.01], move_s=0.2)
    assert load_rig(PAPER, ['task={kind="point_to_point", axes=["y"], target=[0.01], move_s=0.2}']).task == table


def test_gains_of_the_files_law_are_not_taken_for_another_law() -> None:
    document = tomllib.loads(PAPER.read_text(encoding="utf-8"))
    document["law"] |= {"name": "robust-pd", "gains": {"kp": [7.0, 8.0]}}
    assert build_rig(copy.deepcopy(document)).law.gains == {"kp": [7.0, 8.0]}
    assert build_rig(copy.deepcopy(document), ["law.name=robust-pd"]).law.gains == {"kp": [7.0, 8.0]}, "the same law"
    assert build_rig(copy.deepcopy(document), ["law.name=pid"]).law.gains == {}
    chosen = ["law.gains.kp=[1.0, 1.0]", "law.name=pid"]  # gains given with a law are for it, in whatever order
    assert build_rig(copy.deepcopy(document), chosen).law.gains == {"kp": [1.0, 1.0]}


def test_an_override_of_the_emulated_encoder_alone_changes_the_axes_with_it() -> None:
    rig = load_rig(PAPER, ["plant.encoder_resolution=5e-9"])
    assert [axis.encoder_resolution for axis in rig.axes.values()] == [5e-9, 5e-9]
    each = load_rig(PAPER, ["plant.encoder_resolution=[5e-9, 4e-9]", "axes.x.limits.speed=1.0"])
    assert [axis.encoder_resolution for axis in each.axes.values()] == [5e-9, 4e-9]


@pytest.mark.parametrize("stated", ["axes.x.encoder_resolution=3e-9", "axes.y.encoder_resolution=3e-9"])
def test_an_override_of_one_axis_encoder_beside_it_leaves_the_axes_to_what_they_say(stated: str) -> None:
    """Two statements are a modelling error that somebody wants."""
    before = {name: axis.encoder_resolution for name, axis in load_rig(PAPER).axes.items()}
    rig = load_rig(PAPER, ["plant.encoder_resolution=5e-9", stated])
    assert {name: axis.encoder_resolution for name, axis in rig.axes.items()} == before | {stated[5]: 3e-9}
    assert rig.plant.encoder_resolution == 5e-9


@pytest.mark.requirement(id="SR-5.5")
@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("rate_hz=nan", "rate_hz"),
        ("rate_hz=0", "greater than or equal to 10"),
        ("plant.mass=[1.0, 2.0, 3.0]", "plant.mass has 3 values for 2 axes"),
        ("law.unknown=1", "law.unknown"),
        ("task.kind=circel", "task.kind = 'circel': the nearest is circle; the tasks are hold, circle"),
        ("axes.x.limits.force=99", "exceeds rated_force"),
        ("axes.x.limits.position=[1.0, -1.0]", "the first must be below the second"),
        ("wire.drop_probability=1.5", "less than 1"),
        ("task.axes=['x', 'q']", "no axis 'q'"),
        ("rate_hz.deeper=1", "'rate_hz' is a value"),
        ("nonsense", "expected key.path=value"),
        ("task.kind=injection", "[task.injection]"),
        ("plant.modelling_error=-0.1", "plant.modelling_error"),
        ("bus.options={bitrate=1}", "options: none are taken with interface = 'auto'"),
        ("bus.parameters={a=1}", "parameters: of a frame layout of your own; protocol = 'stage_fd' takes none"),
        ("bus.moteus={}", "moteus: a table of protocol = 'moteus', not of 'stage_fd'"),
        ("plant.stribeck_scale=[]", "plant.stribeck_scale has 0 values for 2 axes"),
        ("plant.mass=[]", "plant.mass has 0 values for 2 axes"),
        ("estimator.disturbance_noise=[]", "estimator.disturbance_noise has 0 values for 2 axes"),
        (
            "axes.x.limits.force=5e-324",
            "axes.x.limits.force = 5e-324: Input should be greater than or equal to 0.000000000000001",
        ),
        ("axes.x.model.mass=1e300", "axes.x.model.mass = 1e+300: Input should be less than or equal to"),
        *(
            (f"axes.x.model.presliding={wrong}", f"presliding = {wrong}: allowed: [least, greatest], or an empty list")
            for wrong in ("[2e-06]", "[2e-06, 1e-06]")
        ),
        ("axes.x.model.other_modes=[[0.5, 0.01, 0.05]]", "other_modes has [0.5, 0.01, 0.05]: allowed: 1 to 5000 Hz"),
        ("axes.x.model.other_modes=[[280.0, 0.01]]", "other_modes"),
        ('plant.slip=[{axis="y"}]', "plant.slip: axis y has plant.presliding = 0"),
        ("rate_hz=100", "drives.watchdog_s = 0.01: it must be longer than the 0.01 s from one command to the next"),
    ],
)
def test_a_bad_value_is_refused_with_its_key_and_the_allowed_range(override: str, expected: str) -> None:
    with pytest.raises(RigError) as caught:
        load_rig(PAPER, [override])
    assert expected in str(caught.value)


def test_all_problems_are_named_at_once() -> None:
    with pytest.raises(RigError) as caught:
        load_rig(PAPER, ["rate_hz=1", "bus.bitrate=5", "task.radius=-1", "nosuchkey=1"])
    assert len(caught.value.problems) == 4


@pytest.mark.parametrize(
    ("rate_hz", "blackbox_s", "period_ns", "slots"),
    [(1000, 60, 1_000_000, 60_000), (300, 1.5, 3_333_333, 450), (600.5, 1, 1_665_279, 601), (200, 1, 5_000_000, 256)],
)
def test_the_ring_holds_the_black_box_s_time_and_at_least_256_ticks(
    rate_hz: float, blackbox_s: float, period_ns: int, slots: int
) -> None:
    rig = load_rig(PAPER, [f"rate_hz={rate_hz}", f"telemetry.blackbox_s={blackbox_s}"])
    assert (rig.period_ns, rig.ring_slots) == (period_ns, slots)


def test_a_refusal_reads_as_a_line_for_each_problem() -> None:
    error = RigError(["rate_hz = 1: too few", "bus.bitrate = 5: too few"])
    assert str(error) == "rate_hz = 1: too few\nbus.bitrate = 5: too few"
    assert str(error.of_file("my.toml")) == "my.toml: rate_hz = 1: too few\nmy.toml: bus.bitrate = 5: too few"


def test_a_missing_file_and_a_broken_file_are_refused(tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_bytes(b"name = [\xff")
    for path in (tmp_path / "none.toml", broken):
        with pytest.raises(RigError):
            load_rig(path)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a = " + "1" * 5000, "not a TOML document"),
        ("rate_hz = 0x" + "f" * 5000, "a number of thousands of digits"),
        ("description = 5\nname = '" + "x" * 100_000 + "'", "name = 'xxxxx"),
        ("\ufeffname = 'x'", "byte order mark"),
        ("#" * LARGEST + "\n", f"longer than {LARGEST} bytes"),
    ],
)
def test_documents_beyond_all_bounds_are_refused_in_a_few_lines(tmp_path: Path, content: str, reason: str) -> None:
    path = tmp_path / "odd.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(RigError) as caught:
        load_rig(path)
    assert reason in str(caught.value)
    assert all(len(line) < 500 for line in caught.value.problems)


def test_what_is_no_file_is_refused_without_waiting(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    for path in ("/dev/zero", "/dev/null", pipe):
        with pytest.raises(RigError, match="not a file but a"):
            load_rig(path)


@pytest.mark.parametrize(
    "content",
    [
        ".".join(["a"] * 100_000) + " = 1",
        "[" + ".".join(["a"] * 100_000) + "]",
        "a = {" + ".".join(["'b'"] * 50_000) + " = 1}",
        "\n".join(f"k{i}." + ".".join(["a"] * 28) + " = 1" for i in range(4000)),
        "[" + ".".join(["a"] * 32) + "]\n" + "\n".join(f"k{i} = 1" for i in range(25_000)),
        "\n".join(f"k{i} = 1" for i in range(25_000)),
        "\n".join(["[[x]]"] * 40_000),
        "a = " + "[" * 400 + "]" * 400,
        "a = " + "{a = " * 300 + "1" + "}" * 300,
        "task.target = [" + "'a'," * 60_000 + "]",
        "task.axes = [" + "'a'," * 60_000 + "]",
        "rate_hz = 1e999",
        "rate_hz = -" + "9" * 4000,
    ],
    ids=lambda content: content[:12],
)
def test_the_worst_documents_take_bounded_time_and_a_bounded_refusal(content: str, tmp_path: Path) -> None:
    path = tmp_path / "worst.toml"
    path.write_text(content)
    began = time.process_time()
    with pytest.raises(RigError) as caught:
        load_rig(path)
    assert time.process_time() - began < 2.0
    assert len(caught.value.problems) <= MOST_PROBLEMS + 1
    assert all(len(line) < 1000 for line in caught.value.problems)


@pytest.mark.parametrize(
    "overrides",
    [
        ["axes=5", "plant.encoder_resolution=1e-9"],
        ["axes.x=5", "plant.encoder_resolution=1e-9"],
        ["law=5", "law.name=pid"],
        ["rate_hz=" + "1" * 5000],
        ["law.gains=" + "[" * 5000],
        [".".join(["a"] * 100_000) + "=1"],
        ["law.gains=" + ".".join(["a"] * 100_000)],
        ["plant.mass=0x" + "f" * 5000],
        ["drives=5", "plant.watchdog_s=0.1"],
        ["plant=5"],
    ],
)
def test_overrides_that_make_no_sense_together_are_refused(overrides: list[str]) -> None:
    with pytest.raises(RigError):
        load_rig(PAPER, overrides)


def test_the_same_rig_has_the_same_hash_whatever_its_comments_and_order(tmp_path: Path) -> None:
    copy = tmp_path / "copy.toml"
    copy.write_text("# a comment\n" + PAPER.read_text())
    assert rig_hash(load_rig(copy)) == rig_hash(load_rig(PAPER))
    assert rig_hash(load_rig(PAPER, ["rate_hz=999"])) != rig_hash(load_rig(PAPER))


@given(st.binary(max_size=200))
def test_no_bytes_make_anything_but_a_rig_or_a_refusal(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("rig") / "fuzz.toml"
    path.write_bytes(data)
    with pytest.raises(RigError):
        load_rig(path)


KEYS = st.sampled_from(
    [*SCRIPTABLE, "axes.x.limits.force", "safety.stop_s", "bus.protocol", "timing.priority", "x", ""]
)
VALUES = st.one_of(st.floats().map(repr), st.integers().map(str), st.text(max_size=12), st.just("[]"), st.just("{}"))


@given(st.lists(st.tuples(KEYS, VALUES).map("=".join), max_size=4))
def test_any_override_gives_a_valid_finite_rig_or_a_refusal(overrides: list[str]) -> None:
    try:
        rig = load_rig(PAPER, overrides)
    except RigError as error:
        refusal = error.problems
        assert refusal
    else:
        assert isinstance(rig, RigConfig)
        assert math.isfinite(rig.rate_hz)


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["sim", "--set", "rate_hz=nan"], "rate_hz"),
        (["check", "--set", "bus.protocol=dbc:none.dbc"], "bus.protocol = 'dbc:none.dbc'"),
        (["sweep", "--laws", "magic", "--plants", "1"], "law.name = 'magic'"),
        (["tune", "--law", "pid", "--set", "law.tuned.pid.kp=[1.0]"], "law.gains.kp has 1 values for 2 axes"),
    ],
)
def test_the_command_line_exits_with_78_and_no_traceback(words: list[str], reason: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hil", words[0], str(PAPER), *words[1:]]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert result.returncode == EXIT_CONFIG
    assert reason in result.stderr
    assert "Traceback" not in result.stderr
