#!/usr/bin/env bash
# The vcan tests without a virtual machine, where this machine's kernel has vcan and we may use it.
set -euo pipefail

cd "$(dirname "$0")/../.."
PATH=$PATH:/usr/sbin:/sbin
if [ "$(id -u)" -ne 0 ]; then
    echo "vcan: making interfaces needs root; run as root, or use: make test-vm" >&2
    exit 1
fi
if ! modprobe vcan 2>/dev/null || ! ip link add hilprobe type vcan 2>/dev/null; then
    echo "vcan: this machine's kernel ($(uname -r)) has no vcan; use: make test-vm" >&2
    exit 1
fi
ip link delete hilprobe
exec env HIL_VM=1 .venv/bin/python -m pytest tests/vm -m "vcan and not systemd" -vv
