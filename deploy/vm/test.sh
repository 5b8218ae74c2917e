#!/usr/bin/env bash
# Boots a PREEMPT_RT kernel under QEMU (software emulation, no KVM), on this machine's own file system read-only, runs
# tests/vm in it and brings the results out to .vm/results. Exit status 0 only if the guest ran tests and all passed.
# Tests marked slow run only when named: test.sh tests/vm/test_hostile.py -vv
# usage: test.sh [PYTEST ARGUMENTS]     --last-failed alone: what failed the last time, or all if it did not get that far
set -euo pipefail

PROJECT=$(cd "$(dirname "$0")/../.." && pwd)
VM=$PROJECT/.vm
RESULTS=$VM/results
LIMIT=${HIL_VM_LIMIT:-4500}  # s, whole guest; it takes 11 to 16 minutes, by the host and its load

"$PROJECT/deploy/vm/prepare.sh" "$VM"
LANE=(tests/vm -m "(vcan or controller) and not systemd and not slow" -vv --durations=15)
kept=none  # of the last results
case "$*" in
"") arguments=("${LANE[@]}") ;;
--last-failed) arguments=("${LANE[@]}" --last-failed) kept=cache ;;  # pytest's list of what failed
*) arguments=("$@") ;;
esac
mkdir -p "$RESULTS"
find "$RESULTS" -mindepth 1 -maxdepth 1 ! -name "$kept" -exec rm -rf {} +
# the guest has no network: tests/vm/test_foreign_npm.py says what is missing where this is
npm_package=$(sed -nE 's/^PACKAGE = "(.*)"$/\1/p' "$PROJECT/tests/foreign/npm_package.py")
if command -v npm > /dev/null && [ ! -d "$VM/npm/node_modules" ]; then
    npm install "$npm_package" --no-audit --no-fund --prefix "$VM/npm" > /dev/null 2>&1 || rm -rf "$VM/npm"
fi
# the guest cannot write byte code, and compiles slowly
"$PROJECT/.venv/bin/python" -m compileall -q "$PROJECT"/{hil,drivers,sim_plant,tests} || true

# two SJA1000 controllers behind their real driver, on one emulated bus: can0 and can1 in the guest
devices="-object can-bus,id=canbus0 -device kvaser_pci,canbus=canbus0 -device kvaser_pci,canbus=canbus0"
"$PROJECT/deploy/vm/boot.sh" "$LIMIT" "$RESULTS" 2 2G "$devices" \
    /bin/bash "$PROJECT/deploy/vm/guest_host_root.sh" "$PROJECT" "$RESULTS" "${arguments[@]}"
exec "$PROJECT/deploy/vm/verdict.py" "$RESULTS"
