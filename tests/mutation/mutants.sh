#!/usr/bin/env bash
# Full branch coverage of gate and state machine first, then every mutant of them, in a copy of the tree.
set -euo pipefail
cd "$(dirname "$0")/../.."
bin=$PWD/.venv/bin
"$bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r tests/mutation/requirements.lock
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
export PATH=$bin:$PATH PYTHONDONTWRITEBYTECODE=1 COVERAGE_FILE=$scratch/coverage
python -m coverage run --branch --include=hil/cycle/gate.py,hil/cycle/state_machine.py -m pytest -q -p no:cacheprovider \
    tests/cycle/test_gate.py tests/cycle/test_state_machine.py
python -m coverage report --fail-under=100 -m
mkdir "$scratch/tree"
git ls-files -z drivers hil tests pyproject.toml | xargs -0 cp --parents -t "$scratch/tree"
cd "$scratch/tree"
export PYTHONPATH=.
cosmic-ray init tests/mutation/cosmic-ray.toml ../session.sqlite
python tests/mutation/run.py ../session.sqlite
python tests/mutation/verdict.py ../session.sqlite
