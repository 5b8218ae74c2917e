#!/usr/bin/env bash
# Installs the Debian package on a fresh guest with systemd as init, and tests the service there as a rig's PC would run it.
# Results come out to .vm/results-systemd. Exit status 0 only if the guest ran tests and all passed.
# usage: test_systemd.sh [TEST FILES, in the story's order; all]
# HIL_VM_MARKS: which tests of them; "slow" are those that take this guest ten minutes
set -euo pipefail

PROJECT=$(cd "$(dirname "$0")/../.." && pwd)
VM=$PROJECT/.vm
SHARE=$VM/share
RESULTS=$VM/results-systemd
LIMIT=${HIL_VM_LIMIT:-4500}  # s, whole guest; it takes 11 to 40 minutes, by the host and its load
PATH=$PATH:/usr/sbin:/sbin

"$PROJECT/deploy/vm/prepare.sh" "$VM"
"$PROJECT/deploy/vm/systemd_image.sh" "$VM"
rm -rf "$SHARE" "$RESULTS" && mkdir -p "$SHARE/results" "$SHARE/packages/upgrade"
"$PROJECT/deploy/debian/build.sh" "$SHARE/packages"
# the same package under a later version, for the upgrade
dpkg-deb -R "$SHARE"/packages/hil_*.deb "$SHARE/later"
sed -i 's/^Version:.*/Version: 99.0/' "$SHARE/later/DEBIAN/control"
dpkg-deb --root-owner-group -Zzstd -z3 --build "$SHARE/later" "$SHARE/packages/upgrade/hil_99.0.deb" >/dev/null
rm -rf "$SHARE/later"
mkdir -p "$SHARE/tests/vm" "$SHARE/docs"
cp "$PROJECT/tests/__init__.py" "$SHARE/tests/"
cp -r "$PROJECT"/tests/vm/{__init__,links,slcan,doctor_truth}.py "$PROJECT/tests/vm/systemd" "$SHARE/tests/vm/"
mkdir -p "$SHARE/tests/support" && cp "$PROJECT/tests/support/misbehaves.py" "$SHARE/tests/support/"
cp -r "$PROJECT/examples" "$SHARE/"
cp "$PROJECT/docs/at-the-rig.md" "$SHARE/docs/"
cp "$PROJECT/deploy/vm/guest_systemd.sh" "$SHARE/guest.sh"
echo "${*:-tests/vm/systemd}" > "$SHARE/arguments"
echo "${HIL_VM_MARKS:-systemd and not slow}" > "$SHARE/marks"

kernel=$(cat "$VM/kernel/ready")
echo "vm: booting $kernel with systemd in software emulation; limit $LIMIT s"
"$PROJECT/deploy/vm/watched.sh" "$LIMIT" "$SHARE/results" \
    qemu-system-x86_64 -machine q35,accel=tcg -cpu max -smp 2 -m 2G -nographic -no-reboot \
    -net none -kernel "$VM/kernel/boot/vmlinuz-$kernel" -initrd "$VM/systemd.initrd" \
    -append "console=ttyS0 panic=-1 systemd.unit=hil-test.target systemd.default_timeout_start_sec=300s $(cat "$PROJECT/deploy/vm/kernel_options")" \
    -drive "file=$VM/systemd.ext4,if=virtio,format=raw,snapshot=on,cache=unsafe" \
    -virtfs "local,path=$SHARE,mount_tag=share,security_model=none" \
    -object can-bus,id=canbus0 -device kvaser_pci,canbus=canbus0 -device kvaser_pci,canbus=canbus0
mv "$SHARE/results" "$RESULTS"
rm -rf "$SHARE"
exec "$PROJECT/deploy/vm/verdict.py" "$RESULTS"
