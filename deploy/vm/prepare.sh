#!/usr/bin/env bash
# Puts everything the VM lane needs into DIR (default .vm): a PREEMPT_RT kernel with its modules, virtme-ng, and, from
# Debian, QEMU and the foreign CAN tools. Does nothing where it is there already. Prints what it installs.
set -euo pipefail

PROJECT=$(cd "$(dirname "$0")/../.." && pwd)
VM=${1:-$PROJECT/.vm}
PYTHON=${PYTHON:-$(command -v python3.11 || command -v python3)}
# command -> Debian package that brings it
declare -A NEEDS=(
    [qemu-system-x86_64]=qemu-system-x86 [candump]=can-utils [cyclictest]=rt-tests [depmod]=kmod [ip]=iproute2
    [busybox]=busybox-static [file]=file [mmdebstrap]=mmdebstrap [timeout]=coreutils
)

say() { echo "vm: $*" >&2; }
die() { say "$*"; exit 1; }

refreshed=
refresh_lists() {  # a fresh machine has no package lists, an old one stale ones
    [ -n "$refreshed" ] || [ "$(id -u)" -ne 0 ] || apt-get update -qq >&2 || die "apt-get update failed"
    refreshed=yes
}

install_packages() {
    local command missing=()
    for command in "${!NEEDS[@]}"; do
        # sbin is not on every user's path
        PATH=$PATH:/usr/sbin:/sbin command -v "$command" >/dev/null || missing+=("${NEEDS[$command]}")
    done
    [ ${#missing[@]} -eq 0 ] && return
    mapfile -t missing < <(printf '%s\n' "${missing[@]}" | sort -u)
    command -v apt-get >/dev/null || die "needs ${missing[*]}; install them (this script knows apt only)"
    [ "$(id -u)" -eq 0 ] || die "needs root once, to install: ${missing[*]}   (or: sudo apt-get install ${missing[*]})"
    say "installing ${missing[*]}"
    refresh_lists
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >&2
}

unpack_kernel() {
    local package deb
    [ -e "$VM/kernel/ready" ] && return
    [ "$(uname -m)" = x86_64 ] || die "the lane boots Debian's amd64 kernel; this machine is $(uname -m)"
    refresh_lists
    # linux-image-rt-amd64 is a metapackage: the kernel it stands for today has the version in its name
    package=$(apt-cache depends linux-image-rt-amd64 | sed -n 's/^ *Depends: \(linux-image-[^ ]*\)$/\1/p' | head -1)
    [ -n "$package" ] || die "apt knows no linux-image-rt-amd64 (Debian's main repository is needed)"
    say "fetching $package"
    rm -rf "$VM/kernel" && mkdir -p "$VM/kernel"
    # /tmp: apt's own unprivileged user may not be able to write into the project
    local download
    download=$(mktemp -d) && chmod 755 "$download"
    (cd "$download" && apt-get download -qq "$package" >&2) || die "cannot download $package"
    deb=("$download"/*.deb)
    dpkg-deb -x "${deb[0]}" "$VM/kernel"
    rm -rf "$download"
    PATH=$PATH:/usr/sbin:/sbin depmod -b "$VM/kernel" "${package#linux-image-}"
    echo "${package#linux-image-}" > "$VM/kernel/ready"
}

install_virtme() {
    local lock="$PROJECT/deploy/vm/requirements.lock"
    cmp -s "$lock" "$VM/venv/installed.lock" && return
    say "installing virtme-ng into $VM/venv"
    rm -rf "$VM/venv"
    "$PYTHON" -m venv "$VM/venv"
    "$VM/venv/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r "$lock" >&2
    cp "$lock" "$VM/venv/installed.lock"
}

mkdir -p "$VM"
install_packages
unpack_kernel
install_virtme
