#!/usr/bin/env bash
# Makes, once, what the systemd guest boots: DIR/systemd.ext4, a fresh Debian with systemd as init, and DIR/systemd.initrd.
# Nothing of the project is in it: the package under test is installed inside the running guest.
# usage: systemd_image.sh DIR     (after prepare.sh DIR)
set -euo pipefail

VM=$1
PATH=$PATH:/usr/sbin:/sbin
kernel=$(cat "$VM/kernel/ready")
suite=$(. /etc/os-release && echo "${VERSION_CODENAME:-bookworm}")
# what the package depends on, foreign tools, and what runs the tests
packages=systemd,systemd-sysv,dbus,udev,iproute2,kmod,can-utils,procps,python3,python3-pytest
recipe="$kernel $suite $packages $(cksum < "$0")"

[ "$(cat "$VM/systemd.recipe" 2>/dev/null)" != "$recipe" ] || exit 0
[ "$(id -u)" -eq 0 ] || { echo "vm: making the systemd guest's image needs root once" >&2; exit 1; }
echo "vm: making a Debian $suite image with systemd" >&2
rm -f "$VM/systemd.recipe"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# --- root file system
mmdebstrap --quiet --variant=minbase --include="$packages" "$suite" "$work/root.tar" >&2
mkdir "$work/root"
tar -xf "$work/root.tar" -C "$work/root" --exclude='./dev/*'
rm "$work/root.tar"
rm -rf "$work"/root/var/cache/apt/archives/*.deb "$work"/root/usr/share/{doc,man,locale}
modules=lib/modules/$kernel
for part in net drivers/net/can drivers/virtio drivers/block fs/9p fs/netfs fs/fscache fs/ext4 fs/jbd2 lib crypto arch; do
    [ -e "$VM/kernel/$modules/kernel/$part" ] || continue
    mkdir -p "$work/root/$modules/kernel/$(dirname "$part")"
    cp -a "$VM/kernel/$modules/kernel/$part" "$work/root/$modules/kernel/$part"
done
cp -a "$VM/kernel/$modules"/modules.{order,builtin,builtin.modinfo} "$work/root/$modules/"
depmod -b "$work/root" "$kernel"
echo hil-guest > "$work/root/etc/hostname"
echo '/dev/vda / ext4 rw 0 1' > "$work/root/etc/fstab"
: > "$work/root/etc/machine-id"
rm -f "$work"/root/etc/systemd/system/getty.target.wants/*
cat > "$work/root/etc/systemd/system/hil-test.service" <<'INNER'
[Unit]
Description=Tests of the installed service
After=multi-user.target
SuccessAction=poweroff-force
FailureAction=poweroff-force
[Service]
Type=oneshot
Environment=HOME=/root LANG=C.UTF-8 PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
ExecStartPre=/usr/sbin/modprobe 9pnet_virtio
ExecStartPre=/usr/bin/mkdir -p /share
ExecStartPre=/usr/bin/mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000 share /share
ExecStart=/bin/bash /share/guest.sh
StandardOutput=journal+console
TimeoutStartSec=infinity
INNER
cat > "$work/root/etc/systemd/system/hil-test.target" <<'INNER'
[Unit]
Description=Test run
Wants=hil-test.service
Requires=multi-user.target
After=multi-user.target
AllowIsolate=yes
INNER
truncate -s 3G "$work/image"
mke2fs -q -t ext4 -O ^has_journal -d "$work/root" "$work/image" >&2

# --- initrd: just enough to mount it
mkdir -p "$work/initrd"/{bin,proc,sys,dev,newroot,modules}
cp "$(command -v busybox)" "$work/initrd/bin/busybox"
for applet in mount insmod sleep switch_root poweroff; do ln -s busybox "$work/initrd/bin/$applet"; done
{
    echo '#!/bin/busybox sh'
    echo 'export PATH=/bin'
    echo 'mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev'
    for module in virtio_pci virtio_blk crc32c_generic ext4; do
        modprobe -d "$VM/kernel" -S "$kernel" --show-depends "$module" 2>/dev/null
    done | awk '$1 == "insmod" && !seen[$2]++ {print $2}' | while read -r file; do
        cp "$file" "$work/initrd/modules/"
        echo "insmod /modules/$(basename "$file")"
    done
    echo 'i=0; while [ ! -b /dev/vda ] && [ $i -lt 300 ]; do sleep 0.1; i=$((i+1)); done'
    echo 'mount -t ext4 /dev/vda /newroot && exec switch_root /newroot /sbin/init'
    echo 'echo "initrd: no root file system"; poweroff -f'
} > "$work/initrd/init"
chmod +x "$work/initrd/init"
(cd "$work/initrd" && find . | busybox cpio -o -H newc 2>/dev/null | gzip -1) > "$VM/systemd.initrd"
mv "$work/image" "$VM/systemd.ext4"
echo "$recipe" > "$VM/systemd.recipe"
