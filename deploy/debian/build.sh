#!/usr/bin/env bash
# Builds dist/hil_VERSION_ARCH.deb with dpkg-deb. The package carries its Python packages, taken by hash from
# requirements.lock, so that installing it reaches for no registry. It fits the Debian whose python3 is of the same minor
# version as the project's .venv (3.11: Debian 12). Its control path is compiled, as that halves what a tick costs; where
# this machine cannot compile, it is the source as it is. Either way `hil --version` says which.
# usage: build.sh [OUTPUT DIRECTORY]
set -euo pipefail

cd "$(dirname "$0")/../.."
OUTPUT=${1:-dist}
PYTHON=.venv/bin/python
command -v dpkg-deb >/dev/null || { echo "deb: needs dpkg-deb (a Debian or Ubuntu machine)" >&2; exit 1; }

version=$($PYTHON -c 'import tomllib; print(tomllib.load(open("pyproject.toml", "rb"))["project"]["version"])')
version=${HIL_DEB_VERSION:-$version}
minor=$($PYTHON -c 'import sys; print("%d.%d" % sys.version_info[:2])')
architecture=$(dpkg --print-architecture)
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct 2>/dev/null || echo 0)
export SOURCE_DATE_EPOCH

control_path=interpreted
if $PYTHON deploy/compiled/build.py --check; then
    make --no-print-directory compiled
    control_path=compiled
fi

stage=$(mktemp -d)
trap 'rm -rf "$stage"' EXIT
chmod 755 "$stage"
root=$stage/root
packages=opt/hil/lib/python$minor/site-packages
pip() { $PYTHON -m pip -qq --disable-pip-version-check "$@"; }

# --- /opt/hil: a virtual environment on the system's Python
mkdir -p "$root/opt/hil/bin" "$root/$packages"
ln -s "/usr/bin/python$minor" "$root/opt/hil/bin/python3"
printf 'home = /usr/bin\ninclude-system-site-packages = false\nversion = %s\n' "$minor" > "$root/opt/hil/pyvenv.cfg"
$PYTHON deploy/debian/runtime_lock.py requirements.lock page > "$stage/runtime.lock"
pip install --no-compile --no-deps --require-hashes --only-binary :all: --target "$root/$packages" -r "$stage/runtime.lock"
pip wheel --no-deps --no-build-isolation --wheel-dir "$stage" .
pip install --no-compile --no-deps --target "$root/$packages" "$stage"/hil-*.whl
rm -rf "$root/$packages/bin"
if [ $control_path = compiled ]; then  # the same packages with the extension modules beside their sources
    built=.venv-compiled/lib/python$minor/site-packages
    cp -r "$built"/{hil,drivers,sim_plant,*.so} "$root/$packages/"
    find "$root/$packages"/{hil,drivers,sim_plant} -name __pycache__ -prune -exec rm -rf {} +
fi
# a tenth of the package, and never imported by it
find "$root/$packages"/{numpy,scipy,matplotlib} -type d -name tests -prune -exec rm -rf {} +
# byte code once, here; hash-based, so that no file time can make it stale
$PYTHON -m compileall -q -j 0 -s "$root" -p / --invalidation-mode unchecked-hash "$root/$packages" || true
# guarded: worker processes of hil faults and hil reproduce read this file too
printf '#!/opt/hil/bin/python3 -I\nfrom hil.__main__ import main\n\nif __name__ == "__main__":\n    main()\n' > "$root/opt/hil/bin/hil"
chmod 755 "$root/opt/hil/bin/hil"

# --- the rest of the system
mkdir -p "$root/usr/bin" "$root/usr/share/doc/hil" "$root/usr/share/hil" "$root/DEBIAN"
ln -s /opt/hil/bin/hil "$root/usr/bin/hil"
ln -s "/$packages/hil/deploy/rigs" "$root/usr/share/hil/rigs"
cp LICENSE "$root/usr/share/doc/hil/copyright"
cp docs/at-the-rig.md docs/page.md "$root/usr/share/doc/hil/"
$PYTHON - "$root" <<'INNER'
import sys
from pathlib import Path

from hil.operate.install import system_files

for name, content in system_files("/usr/bin/hil", packaged=True).items():
    path = Path(sys.argv[1], name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
INNER

# --- the package
install -m 755 deploy/debian/{postinst,prerm,postrm} "$root/DEBIAN/"
cat > "$root/DEBIAN/control" <<INNER
Package: hil
Version: $version
Architecture: $architecture
Maintainer: HIL developers <root@localhost>
Installed-Size: $(du -sk --exclude=DEBIAN "$root" | cut -f1)
Depends: python$minor, systemd, udev, iproute2, kmod
Recommends: can-utils
Section: science
Priority: optional
Description: Hardware-in-the-loop control service for micro-injection stages over CAN
 Closes the position loop of a motion stage over CAN as a systemd service, with telemetry, recording and an emulated
 stage to try it on. The control path is $control_path.
INNER
find "$root" -type d -exec chmod 755 {} +
find "$root" -newermt "@$SOURCE_DATE_EPOCH" -exec touch --no-dereference --date "@$SOURCE_DATE_EPOCH" {} +
mkdir -p "$OUTPUT"
package=$OUTPUT/hil_${version}_${architecture}.deb
dpkg-deb --root-owner-group -Zzstd -z10 --build "$root" "$package" >/dev/null
echo "deb: $package, $(du -h "$package" | cut -f1), control path $control_path"
