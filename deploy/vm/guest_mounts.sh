# Sourced inside a guest: this machine's own file system, which is its root, at /tmp/host, with the guest's own devices and
# RESULTS writable. The root that virtme-ng mounts caches nothing; the same tree mounted again with a cache starts Python
# twice as fast. Sets host.
# usage: . guest_mounts.sh RESULTS
host=/tmp/host
mkdir -p $host
mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=loose,ro hostroot $host || exit 70
for directory in proc sys dev run tmp; do mount --rbind /$directory $host/$directory; done
mount --bind "$1" "$host$1" || exit 70
ip link set lo up
