#!/bin/bash
# Runs inside the guest whose clock counts instructions: benchmark ARGUMENTS on PROJECT's compiled build. Leaves bench.log and,
# last of all, `status` in RESULTS.
#
# Idle time is skipped in that guest, and it idles while it waits for this machine's files. So that no process's start lasts
# minutes by its clock, what Python reads comes in an archive, as a disk, and is kept in memory.
# usage: guest_counted.sh PROJECT RESULTS "DIRECTORIES OF THE ARCHIVE" ARGUMENTS...
set -u
project=$1 results=$2 directories=$3
shift 3
. "$project/deploy/vm/guest_mounts.sh" "$results"

modprobe virtio_blk
mount -t tmpfs -o size=90% tmpfs /mnt
tar -x -C /mnt -f /dev/vda || exit 70
for directory in $directories; do mount --bind "/mnt$directory" "$host$directory" || exit 70; done

cat > /run/inside.sh <<'INNER'
cd "$1" || exit 70
export HOME=/tmp PYTHONDONTWRITEBYTECODE=1 LANG=C.UTF-8 PATH=$PATH:/usr/sbin:/sbin
results=$2
shift 2
PYTHONSAFEPATH=1 .venv-compiled/bin/python -m tests.benchmarks "$@" >"$results/bench.log" 2>&1
INNER
chroot $host /bin/bash /run/inside.sh "$project" "$results" "$@"
echo $? > "$results/status"
sync
