"""The C programs that benchmarks compare with: compiled where a benchmark needs them."""

import shutil
import subprocess
from pathlib import Path

from hil.operate.bench.live_runs import BenchError


def build_reference(source: Path, directory: Path) -> Path:
    """The C program of a source file, compiled into a directory. Raises BenchError without a compiler."""
    compiler = shutil.which("cc")
    if not compiler:
        raise BenchError("needs a C compiler (apt install gcc)")
    program = directory / source.stem
    subprocess.run([compiler, "-O2", "-o", str(program), str(source), "-lm"], check=True)
    return program
