"""The native kernel against the physics in Python: the same bits, whatever the stage is made of."""

import math
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_plant.config import PlantConfig
from sim_plant.native import library
from sim_plant.physics.native_axis import WORD, WORDS, NativeAxis
from sim_plant.physics.stage import Stage, Truth
from tests.golden.plants.tell import EFFECTS, MS

needs_compiler = pytest.mark.skipif(not library.compiler(), reason="there is no C compiler")


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    """The kernel of these sources, wherever there is a compiler."""
    if library.compiler():
        library.build()
        library.found.cache_clear()


def drawn(low: float, high: float) -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(low, high), min_size=2, max_size=2)


KEYS: dict[str, st.SearchStrategy] = {
    "presliding": st.lists(st.sampled_from([0.0, 1e-7, 1e-6, 1e-5]), min_size=2, max_size=2),
    "presliding_damping": drawn(0.0, 1.0),
    "torque_lag": drawn(0.0, 3e-3),
    "torque_noise": drawn(0.0, 1e-2),
    "friction_variation": drawn(0.0, 0.9),
    "friction_period": drawn(1e-5, 1e-2),
    "cable_stiffness": drawn(0.0, 1e3),
    "cable_hysteresis": drawn(0.0, 0.2),
    "cable_reach": drawn(1e-5, 1e-2),
    "bias": drawn(-0.5, 0.5),
    "bias_walk": drawn(0.0, 0.3),
    "backlash": drawn(0.0, 1e-5),
    "stribeck_scale": drawn(0.0, 2.0),
    "stribeck_velocity": drawn(1e-4, 1e-1),
    "ripple_amplitude": drawn(0.0, 0.2),
    "ripple_period": drawn(1e-5, 1e-1),
    "encoder_noise": drawn(0.0, 1e-7),
    "encoder_periodic_error": drawn(0.0, 1e-7),
    "encoder_latency": drawn(0.0, 1e-3),
    "gravity": drawn(-2.0, 2.0),
    "drift": drawn(-1e-5, 1e-5),
    "slip": st.lists(
        st.fixed_dictionaries(
            {
                "axis": st.sampled_from([None, "x"]),
                "stiffness": st.floats(1e-3, 1e3),
                "limit": st.floats(1e-3, 1e3),
            }
        ),
        min_size=1,
        max_size=4,
    ),
    "modes": st.lists(
        st.fixed_dictionaries(
            {
                "axis": st.sampled_from([None, "x"]),
                "frequency_hz": st.floats(5.0, 900.0),
                "damping": st.floats(0.0, 0.5),
                "load": st.floats(0.01, 0.3),
                "tool": st.booleans(),
            }
        ),
        min_size=1,
        max_size=3,
    ).map(lambda modes: [*modes[:2], *(mode | {"tool": True} for mode in modes[2:])]),
    "cogging": st.lists(
        st.fixed_dictionaries({"amplitude": st.floats(0.0, 0.5), "period": st.floats(1e-5, 0.1)}), max_size=3
    ),
    "vibration": st.lists(
        st.fixed_dictionaries({"acceleration": st.floats(0.0, 1.0), "frequency_hz": st.floats(1.0, 900.0)}),
        max_size=4,
    ),
    "cells": st.fixed_dictionaries(
        {
            "axis": st.just("x"),
            "surface": st.floats(-1e-5, 1e-5),
            "direction": st.sampled_from([-1, 1]),
            "stiffness": st.floats(1e8, 1e14),
            "puncture_depth": st.floats(1e-7, 1e-4),
            "drag": st.floats(0.0, 5.0),
        }
    ).map(lambda cell: [cell]),
}


@st.composite
def plants(draw: st.DrawFn) -> PlantConfig:
    chosen = draw(st.sets(st.sampled_from(sorted(KEYS)), min_size=1))
    base = {
        "mass": draw(drawn(0.05, 2.0)),
        "coulomb": draw(drawn(0.0, 1.5)),
        "viscous": draw(drawn(-0.5, 5.0)),
        "quadratic": draw(drawn(0.0, 5.0)),
        "seed": draw(st.integers(0, 2**32 - 1)),
    }
    keys = {key: draw(KEYS[key]) for key in sorted(chosen)}
    if "slip" in keys:  # elements need it
        keys["presliding"] = draw(drawn(1e-7, 1e-5))
    return PlantConfig(**base, **keys)


def in_python(truth: Truth, position: list[float], velocity: list[float]) -> Stage:
    with patch.object(library, "kernel", return_value=None):
        stage = Stage(truth, position, velocity)
    assert not any(isinstance(axis, NativeAxis) for axis in stage._single.axes)
    return stage


def assert_same_bits(native: Stage, python: Stage) -> None:
    assert native.readings() == python.readings()
    assert native.positions == python.positions
    assert native.velocities == python.velocities
    for fast, slow in zip(native._single.axes, python._single.axes, strict=True):
        assert fast.state == slow.state


pieces = st.lists(st.tuples(st.integers(1, 3 * MS), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), min_size=1, max_size=8)


@pytest.mark.long
@needs_compiler
@settings(max_examples=400, deadline=None)
@given(plants(), drawn(-1e-5, 1e-5), drawn(-2e-2, 2e-2), pieces)
def test_the_kernel_has_the_bits_of_python(
    plant: PlantConfig, position: list[float], velocity: list[float], commands: list[tuple[int, float, float]]
) -> None:
    truth = Truth.from_config(plant, 2, ["x", "y"])
    native, python = Stage(truth, position, velocity), in_python(truth, position, velocity)
    for duration_ns, *force in commands:
        native.advance(duration_ns, force)
        python.advance(duration_ns, force)
        assert_same_bits(native, python)


@needs_compiler
def test_every_effect_is_the_kernels_once_there_is_presliding() -> None:
    for name, value in EFFECTS.items():
        plant = PlantConfig(
            **{"mass": [0.5, 0.3], "coulomb": [0.3, 0.4], "viscous": [1.0, 2.0], "quadratic": [0.1, 0.0]}
            | {"presliding": [1e-6, 1e-5], name: value}
        )
        stage = Stage(Truth.from_config(plant, 2, ["x", "y"]))
        assert all(isinstance(axis, NativeAxis) for axis in stage._single.axes), name


@needs_compiler
def test_brakes_and_changes_find_the_state_where_the_kernel_left_it() -> None:
    plant = PlantConfig(mass=[0.5], coulomb=[0.3], viscous=[1.0], quadratic=[0.0], presliding=1e-6, torque_noise=1e-3)
    truth = Truth.from_config(plant, 1, ["x"])
    native, python = Stage(truth), in_python(truth, [0.0], [0.0])
    for clamp in (0.0, 50.0, 0.0):
        native.clamp([clamp])
        with patch.object(library, "kernel", return_value=None):
            python.clamp([clamp])
        for _ in range(5):
            native.advance(MS, [2.0])
            python.advance(MS, [2.0])
            assert_same_bits(native, python)


@needs_compiler
@pytest.mark.parametrize("force", [1e300, math.inf, math.nan])
def test_what_is_beyond_numbers_ends_as_it_does_in_python(force: float) -> None:
    plant = PlantConfig(
        mass=[0.5],
        coulomb=[0.3],
        viscous=[1.0],
        quadratic=[0.5],
        presliding=1e-6,
        cogging=[{"amplitude": 1, "period": 1}],
    )
    truth = Truth.from_config(plant, 1, ["x"])
    native, python = Stage(truth), in_python(truth, [0.0], [0.0])
    ends = []
    for stage in (native, python):
        try:
            for _ in range(3):
                stage.advance(MS, [force])
            ends.append(repr(stage.positions))
        except (ArithmeticError, ValueError) as error:
            ends.append(repr(error))
    assert ends[0] == ends[1]


@needs_compiler
def test_an_axis_has_the_size_that_python_fills() -> None:
    kernel = library.kernel()
    assert kernel
    assert kernel.size_of_axis == WORDS * WORD


@needs_compiler
def test_two_builds_at_once_leave_one_whole_library(tmp_path: Path) -> None:
    with ThreadPoolExecutor(4) as pool:
        made = set(pool.map(lambda _: library.build(tmp_path / "packages"), range(4)))
    assert [path.name for path in (tmp_path / "packages").iterdir()] == [library.name()]
    assert made == {tmp_path / "packages" / library.name()}


def test_without_a_compiler_it_says_what_to_install(tmp_path: Path) -> None:
    with (
        patch.object(library, "compiler", return_value=[]),
        pytest.raises(library.BuildError, match="apt install gcc"),
    ):
        library.build(tmp_path / "packages")
    assert not (tmp_path / "packages").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_into_a_folder_that_may_not_be_written_it_refuses(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(library.BuildError, match=str(tmp_path)):
        library.build(tmp_path / "packages")


@needs_compiler
def test_a_compiler_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for command in ("false", "true", "no-such-compiler"):
        monkeypatch.setenv("CC", command)
        with pytest.raises(library.BuildError):
            library.build(tmp_path / "packages")
        assert list((tmp_path / "packages").iterdir()) == []


@pytest.mark.parametrize(("value", "native"), [("0", False), ("1", True)])
def test_the_environment_turns_it_off(value: str, native: bool) -> None:
    if native and not library.compiler():
        pytest.skip("there is no C compiler")
    code = "from sim_plant.native.library import kernel; print(kernel() is not None)"
    environment = os.environ | {library.OFF: value}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(native)
