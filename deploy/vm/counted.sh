#!/usr/bin/env bash
# Runs a benchmark (`make bench ARGS=...`) of the compiled build on a machine whose clock counts instructions: a guest of one core in software
# emulation where an instruction takes a nanosecond (QEMU's icount) and idle time is skipped. While this machine stalls, that
# clock stands still. A slot lost there was lost by what was executed there, in the loop or in the kernel under it.
# usage: counted.sh [ARGUMENTS]     none: a million ticks of `misses`, two hours. The guest can write to RESULTS alone,
#                                   which is .vm/results-counted unless the environment has another
set -euo pipefail

PROJECT=$(cd "$(dirname "$0")/../.." && pwd)
VM=$PROJECT/.vm
RESULTS=${RESULTS:-$VM/results-counted}
LIMIT=${HIL_VM_LIMIT:-14400}  # s
[ $# -gt 0 ] || set -- misses --blocks 20 --ticks 50000 --json "$RESULTS/misses.json"

"$PROJECT/deploy/vm/prepare.sh" "$VM"
mkdir -p "$RESULTS"
rm -f "$RESULTS"/{status,bench.log,console.log}
standard_library=$("$PROJECT/.venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("stdlib"))')
directories="$PROJECT/.venv $PROJECT/.venv-compiled $standard_library /etc"
archive=$(mktemp "$VM/counted.XXXXXX")
trap 'rm -f "$archive"' EXIT
# shellcheck disable=SC2086  # several directories
tar -c -P -f "$archive" --ignore-failed-read $directories
"$PROJECT/deploy/vm/boot.sh" "$LIMIT" "$RESULTS" 1 4G \
    "-icount shift=0,sleep=off -drive file=$archive,format=raw,if=virtio,readonly=on" \
    /bin/bash "$PROJECT/deploy/vm/guest_counted.sh" "$PROJECT" "$RESULTS" "$directories" "$@"
if [ ! -e "$RESULTS/status" ]; then
    tail -n 40 "$RESULTS/console.log"
    echo "vm: the guest did not finish; above, the end of its console ($RESULTS/console.log)" >&2
    exit 1
fi
cat "$RESULTS/bench.log"
exit "$(cat "$RESULTS/status")"
