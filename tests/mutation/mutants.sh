#!/usr/bin/env bash
# Full branch coverage of gate and state machine first, then every mutant of them, in a copy of the tree.
set -euo pipefail
cd "$(dirname "$0")/../.."
bin=$PWD/.venv/bin
"$bin/python" -m coverage run --branch --include=hil/gate.py,hil/state_machine.py --data-file=/tmp/hil-mutants.$$.cov \
    -m pytest -q tests/test_gate.py tests/test_state_machine.py
"$bin/python" -m coverage report --data-file=/tmp/hil-mutants.$$.cov --fail-under=100 -m
rm -f /tmp/hil-mutants.$$.cov
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
git ls-files -z | xargs -0 cp --parents -t "$copy"
cd "$copy"
export PATH=$bin:$PATH PYTHONPATH=$copy PYTHONDONTWRITEBYTECODE=1
cosmic-ray init tests/mutation/cosmic-ray.toml session.sqlite
echo "$(cosmic-ray dump session.sqlite | wc -l) mutants"
cosmic-ray exec tests/mutation/cosmic-ray.toml session.sqlite
python tests/mutation/verdict.py session.sqlite
