"""`make compiled`: the compiled build is what it says it is, and computes the same bytes.

Its other tests are those of the source, run on it by `make test-compiled`.
"""

import ast
import os
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from deploy.compiled.build import FOR_BOTH, ONE_RIG, OTHERS, PACKAGES, listed, modules, on_floats
from hil.rig.law_names import LAWS
from hil.rig.provenance import control_path
from tests.support.hashes import RUNS, Situation, ask
from tests.support.paths import ROOT

HERE = ROOT / ".venv-compiled"
TICKS = 3000


def missing_build() -> str:
    """Why there is no build of these sources; empty where there is one."""
    built = HERE / ".built"
    if not built.exists():
        return "no compiled build: make compiled (needs a C compiler and Python's headers)"
    folders = [ROOT / name for name in (*PACKAGES, "deploy/compiled")]
    sources = (
        path for folder in folders for kind in ("py", "dbc", "eds", "c", "h") for path in folder.rglob(f"*.{kind}")
    )
    changed = max(path.stat().st_mtime for path in sources) > built.stat().st_mtime
    return "the compiled build is older than the sources: make compiled" if changed else ""


needs_build = pytest.mark.skipif(bool(missing_build()), reason=missing_build())


def told(*command: str | Path, cwd: Path = ROOT) -> str:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_nothing_compiled_lies_beside_a_source() -> None:
    stray = [path for package in ("hil", "drivers", "sim_plant") for path in (ROOT / package).rglob("*.so")]
    assert stray == []


def test_every_module_listed_is_a_file_and_every_law_is_listed() -> None:
    tables = FOR_BOTH + ONE_RIG + OTHERS
    found, listed = modules(), [name for line in tables.split("\n") for name in line.split()[1:]]
    assert len(set(found)) == len(found)
    assert {Path(name).stem for name in found} >= set(listed) - {"*"}
    laws = {on_floats(law.partition(":")[0].replace(".", "/") + ".py") for law in LAWS.values()}
    assert laws <= set(found)


EAGER = {"all", "any", "bytes", "dict", "frozenset", "join", "list", "max", "min", "set", "sorted", "sum", "tuple"}


def lazy_generators(source: str) -> list[int]:
    """Lines with a generator expression that is not used up on the spot."""
    tree = ast.parse(source)
    used_up = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in EAGER:
            used_up.update(map(id, node.args))
        elif isinstance(node, ast.Starred):
            used_up.add(id(node.value))
    return [n.lineno for n in ast.walk(tree) if isinstance(n, ast.GeneratorExp) and id(n) not in used_up]


def test_no_compiled_module_counts_on_a_generator_being_lazy() -> None:
    """mypyc makes a list of it: over an endless iterator, such as numbers to try, it would never end."""
    assert lazy_generators("next(n for n in count() if free(n))") == [1]
    assert lazy_generators("all(x for x in y), [*(x for x in y)]") == []
    names = [*listed(FOR_BOTH), *listed(ONE_RIG), *listed(OTHERS)]
    assert {name: lines for name in names if (lines := lazy_generators((ROOT / name).read_text()))} == {}


def final_tuples_of_floats(source: str) -> list[int]:
    """Lines with a Final that is a tuple with a float in it."""
    finals = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.AnnAssign) and "Final" in ast.unparse(n)]
    return [
        n.lineno
        for n in finals
        if isinstance(n.value, ast.Tuple)
        and any(isinstance(part, ast.Constant) and isinstance(part.value, float) for part in ast.walk(n.value))
    ]


def defaults_before_keywords(source: str) -> list[str]:
    """Functions in which a keyword that must be given follows an argument that need not be."""
    functions = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef)]
    return [f.name for f in functions if f.args.defaults and None in f.args.kw_defaults]


def test_no_compiled_function_has_a_default_before_a_keyword_without_one() -> None:
    """mypyc (1.x) fails on some of them: it takes all their arguments for positional ones."""
    assert defaults_before_keywords("def f(a, b=1, *, c): ...\ndef g(a, *, c, b=1): ...") == ["f"]
    names = [*listed(FOR_BOTH), *listed(ONE_RIG), *listed(OTHERS)]
    assert {name: found for name in names if (found := defaults_before_keywords((ROOT / name).read_text()))} == {}


def test_no_compiled_module_has_a_final_tuple_of_floats() -> None:
    """mypyc tests whether it was set the wrong way round (1.x): whoever reads it gets a NameError."""
    assert final_tuples_of_floats("A: Final = (-(2.0**31), 1.0)\nB: Final = 1.0\nC: Final = ('a', 'b')") == [1]
    names = [*listed(FOR_BOTH), *listed(ONE_RIG), *listed(OTHERS)]
    assert {name: lines for name in names if (lines := final_tuples_of_floats((ROOT / name).read_text()))} == {}


@needs_build
def test_the_build_says_that_it_is_compiled_even_among_the_sources(tmp_path: Path) -> None:
    for folder in (ROOT, tmp_path):
        assert told(HERE / "bin" / "hil", "--version", cwd=folder).endswith("control path compiled")


@needs_build
def test_every_module_listed_is_the_compiled_one() -> None:
    packages = next(HERE.glob("lib/python*/site-packages"))
    for name in modules():
        stem = (packages / name).with_suffix("")
        assert any(stem.with_name(stem.name + suffix).exists() for suffix in EXTENSION_SUFFIXES), name


@needs_build
def test_the_programs_it_starts_are_compiled_too() -> None:
    start_another = f"""
import contextlib, runpy, subprocess, sys
sys.argv[1:] = ["--version"]
with contextlib.suppress(SystemExit):
    runpy.run_path({str(HERE / "bin" / "hil")!r}, run_name="__main__")
subprocess.run([sys.executable, "-m", "hil", "--version"])  # as `hil demo` and the benchmarks do
"""
    said = told(HERE / "bin" / "python", "-P", "-c", start_another).splitlines()
    assert len(said) == 2
    assert said[1].endswith("control path compiled")


def test_the_sources_say_that_they_are_interpreted() -> None:
    if sys.prefix == str(HERE):
        assert control_path() == "compiled"
    else:
        assert control_path() == "interpreted"


@needs_build
def test_no_interpreted_function_runs_in_every_tick() -> None:
    """One forgotten in the tables costs a tick more than any of its compiled neighbours."""
    run_profiled = """
import sys
from collections import Counter
from tests.support.hashes import run_hash

inside, seen, ticks = False, Counter(), 1500

def note(frame, event, argument):
    global inside
    if event.startswith("c_") and getattr(argument, "__qualname__", "") == "ControlCycle.step":
        inside = event == "c_call"
    elif event == "call" and inside:
        seen[f"{frame.f_code.co_filename}:{frame.f_code.co_qualname}"] += 1

sys.setprofile(note)
run_hash("microscope-ideal.toml", (), ticks)
sys.setprofile(None)
print([name for name, calls in seen.items() if calls > ticks // 10])  # at a change of state there may be some
"""
    assert told(HERE / "bin" / "python", "-P", "-c", run_profiled) == "[]"


@needs_build
def test_a_rig_runs_on_native_floats_and_a_batch_on_arrays() -> None:
    ask_both = """
import numpy as np
from hil.virtual import batch
from hil.cycle import axes as cycle
batch.MotionFilter([np.ones(2)] * 3, np.ones(2)).correct(np.ones(2), 1e-3, np.ones(2))
try:
    cycle.MotionFilter([1.0] * 3, 1.0).correct(np.ones(2), 1e-3, np.ones(2))
except TypeError as error:
    print(error)
"""
    assert told(HERE / "bin" / "python", "-P", "-c", ask_both) == "float object expected; got numpy.ndarray"


@needs_build
def test_every_law_computes_the_same_bytes_as_its_source() -> None:
    hash_all = """
from itertools import product
from hil.rig.law_names import LAWS
from tests.support.hashes import run_hash
task = ("task.frequency_hz=10.0", "task.radius=1e-3", "task.approach_s=0.1", "plant.coulomb=[2.0, 0.3]")
for law, learning in product(LAWS, ("false", "true")):
    overrides = (f"law.name={law}", f"law.iterative_learning={learning}", *task)
    print(law, learning, run_hash("paper.toml", overrides, 400))
"""
    compiled = told(HERE / "bin" / "python", "-P", "-c", hash_all)
    assert len(set(compiled.split()[2::3])) == 2 * len(LAWS)
    assert compiled == told(ROOT / ".venv" / "bin" / "python", "-c", hash_all)


@needs_build
def test_it_computes_the_same_bytes_as_the_interpreted_source() -> None:
    names = list(RUNS)
    source = Situation("source", ROOT / ".venv" / "bin" / "python", {"PYTHONPATH": str(ROOT)})
    compiled = Situation("compiled", HERE / "bin" / "python", {"PYTHONPATH": "", "PYTHONSAFEPATH": "1"})
    assert ask(compiled, names, TICKS) == ask(source, names, TICKS)


@needs_build
def test_users_laws_run_in_it_and_compute_the_same_bytes() -> None:
    hash_all = """
from tests.support.hashes import run_hash
from tests.support.paths import LAWS_OF_USERS
for path in LAWS_OF_USERS:
    law = {"lqr": "Lqr", "lqg": "Lqg", "mpc": "PreviewMpc", "network": "Network", "misbehaves": "Misbehaves"}[path.stem]
    print(law, run_hash("paper.toml", (f"law.name={path}:{law}", "task.radius=1e-3"), 300))
"""
    compiled = told(HERE / "bin" / "python", "-P", "-c", hash_all)
    assert len(set(compiled.split()[1::2])) == 5
    assert compiled == told(ROOT / ".venv" / "bin" / "python", "-c", hash_all)


@needs_build
def test_a_users_frame_layout_runs_in_it_and_carries_the_same_bytes() -> None:
    hash_it = """
from tests.support.hashes import run_hash
from tests.support.wrong_layouts import MAKER
print(run_hash("paper.toml", (f"bus.protocol={MAKER}:Maker", "task.radius=1e-3"), 300))
"""
    compiled = told(HERE / "bin" / "python", "-P", "-c", hash_it)
    assert len(compiled.strip()) == 64
    assert compiled == told(ROOT / ".venv" / "bin" / "python", "-c", hash_it)


@needs_build
def test_a_users_estimator_runs_in_it_and_fails_as_in_the_source() -> None:
    hash_all = """
from tests.support.hashes import run_hash
from tests.support.paths import ROOT
for file, made in (("examples/estimators/luenberger.py", "Luenberger"), ("tests/support/wrong_estimator.py", "Wrong")):
    for law in ("pd-feedforward", "robust-pd"):
        keys = (f"estimator.name={ROOT / file}:{made}", f"law.name={law}", "task.radius=1e-3")
        print(file, law, run_hash("paper.toml", keys, 300))
"""
    compiled = told(HERE / "bin" / "python", "-P", "-c", hash_all)
    assert len(set(compiled.split()[2::3])) == 4
    assert compiled == told(ROOT / ".venv" / "bin" / "python", "-c", hash_all)
