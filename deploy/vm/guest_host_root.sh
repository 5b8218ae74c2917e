#!/bin/bash
# Runs inside the guest, whose root is this machine's own file system, read-only: PROJECT's tests in PROJECT's .venv.
# Leaves junit.xml, pytest.log, dmesg.log and, last of all, `status` in RESULTS.
# usage: guest_host_root.sh PROJECT RESULTS [PYTEST ARGUMENTS]
set -u
project=$1 results=$2
shift 2

. "$project/deploy/vm/guest_mounts.sh" "$results"
for module in can can-raw can-gw vcan kvaser_pci vxcan; do modprobe $module || echo "guest: no module $module"; done

cat > /run/inside.sh <<'INNER'
cd "$1" || exit 70
export PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 MODPROBE_OPTIONS="-d $1/.vm/kernel" HOME=/tmp PYTHONDONTWRITEBYTECODE=1 HIL_VM=1 LANG=C.UTF-8 PATH=$PATH:/usr/sbin:/sbin
results=$2
shift 2
.venv/bin/python -m pytest -o cache_dir="$results/cache" --junitxml="$results/junit.xml" "$@" >"$results/pytest.log" 2>&1
INNER
chroot $host /bin/bash /run/inside.sh "$project" "$results" "$@"
status=$?
dmesg > "$results/dmesg.log"
echo $status > "$results/status"
sync
