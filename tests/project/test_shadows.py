"""A laboratory's own folder may be named as a package of ours: `import hil` then says so, and what to do."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PROGRAM = f"import sys; sys.path.append({str(ROOT)!r}); import hil; hil.load_rig; print('loaded')"


def run(folder: Path, program: str = PROGRAM) -> subprocess.CompletedProcess[str]:
    """A program in a laboratory's folder, which Python looks into first."""
    return subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", ["drivers", "sim_plant"])
def test_a_folder_that_hides_a_package_of_ours_is_named_with_what_to_do(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("")
    done = run(tmp_path)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith(f"ImportError: {tmp_path / name} hides the package '{name}' of hil")
    assert "rename that folder" in last


def test_so_it_is_where_the_other_one_was_loaded_before(tmp_path: Path) -> None:
    (tmp_path / "drivers").with_suffix(".py").write_text("")
    done = run(tmp_path, f"import drivers; {PROGRAM}")
    assert done.returncode == 1
    assert "hides the package 'drivers' of hil" in done.stderr


def test_a_folder_without_python_in_it_and_others_hide_nothing(tmp_path: Path) -> None:
    (tmp_path / "drivers").mkdir()
    (tmp_path / "stages").mkdir()
    (tmp_path / "stages" / "__init__.py").write_text("")
    done = run(tmp_path)
    assert (done.returncode, done.stdout) == (0, "loaded\n"), done.stderr
