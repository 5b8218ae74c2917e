#!/usr/bin/env bash
# Boots the PREEMPT_RT kernel that prepare.sh brought under QEMU (software emulation, no KVM), on this machine's own file
# system read-only, with RESULTS writable; runs COMMAND there as root. The console goes to RESULTS/console.log.
# usage: boot.sh LIMIT RESULTS CPUS MEMORY "QEMU OPTIONS" COMMAND...     LIMIT: s, for the whole guest
set -euo pipefail

PROJECT=$(cd "$(dirname "$0")/../.." && pwd)
VM=$PROJECT/.vm
limit=$1 results=$2 cpus=$3 memory=$4 options=$5
shift 5

kernel=$(cat "$VM/kernel/ready")
printf -v command '%q ' "$@"
host="-virtfs local,path=/,mount_tag=hostroot,security_model=none,readonly=on,multidevs=remap"
echo "vm: booting $kernel in software emulation; limit $limit s"
PATH="$VM/venv/bin:$PATH:/usr/sbin:/sbin" "$PROJECT/deploy/vm/watched.sh" "$limit" "$results" \
    vng --verbose --run "$VM/kernel/boot/vmlinuz-$kernel" --disable-kvm --cpus "$cpus" --memory "$memory" \
    --append "$(cat "$PROJECT/deploy/vm/kernel_options")" --rwdir "$results" --qemu-opts="$host $options" -- "$command"
