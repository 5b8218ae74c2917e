#!/usr/bin/env bash
# Runs a guest for at most LIMIT seconds, its console into RESULTS/console.log, and shows how far the tests in it have come:
# a run that is cut short leaves word of where it was.
# usage: watched.sh LIMIT RESULTS COMMAND...
set -euo pipefail
limit=$1 results=$2
shift 2

timeout --kill-after=10 "$limit" "$@" >"$results/console.log" 2>&1 </dev/null &
guest=$!
trap 'kill "$guest" 2>/dev/null || true' EXIT
tail --pid="$guest" -n +1 -F "$results/pytest.log" 2>/dev/null | while IFS= read -r line; do
    [[ $line =~ ^(tests/vm/.*::|PASSED|FAILED|ERROR|SKIPPED) ]] && printf '%5d s  %.120s\n' "$SECONDS" "$line"
done || true
wait "$guest" || true
echo "vm: guest ended after $SECONDS s"
