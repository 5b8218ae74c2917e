"""`hil install` and `hil uninstall`: put systemd units, network files and a rig file in place, and remove them."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tomlkit
import typer

from drivers.base.named_file import write_text
from drivers.config import KERNEL_INTERFACES, BusConfig
from hil.operate.installed import (
    RIGS,
    Files,
    InstallError,
    Links,
    masked_units,
    put,
    read_manifest,
    refuse_foreign,
    remove,
    remove_all,
)
from hil.rig.brought import named_files
from hil.rig.file import build_rig
from hil.rig.schema import RigConfig, RigError
from hil.rig.shipped import shipped

_UNITS = ("hil-control@.service", "hil-sidecar@.service", "hil-emulator@.service", "hil-page.service", "hil.target")
_PER_RIG = ("hil-control", "hil-sidecar", "hil-emulator")
_PACKAGED_TARGET = "usr/lib/systemd/system/hil.target"


def escape(name: str) -> str:
    """`name` as systemd-escape(1) writes it into a unit's name."""
    return "".join(c if c.isascii() and (c.isalnum() or c in ":_.") else f"\\x{ord(c):02x}" for c in name)


def with_values(text: str, **values: object) -> str:
    """An ini-style file with the values of its existing keys replaced."""
    for key, value in values.items():
        text, found = re.subn(rf"^{key}=.*$", f"{key}={value}", text, flags=re.MULTILINE)
        if not found:
            raise InstallError(f"no line {key}= in the file to be filled in")
    return text


def system_files(executable: str, *, packaged: bool) -> Files:
    """What every rig shares: units, user, directories, device permission.

    executable: absolute path of `hil` for ExecStart. packaged: in a package's directories, else in the administrator's.
    """
    source = shipped("systemd")
    base, udev = ("usr/lib", "usr/lib/udev") if packaged else ("etc", "etc/udev")
    units = {
        f"{base}/systemd/system/{name}": (source / "units" / name)
        .read_text()
        .replace("/usr/bin/hil ", f"{executable} ")
        for name in _UNITS
    }
    return {
        **units,
        f"{base}/sysusers.d/hil.conf": (source / "sysusers.conf").read_text(),
        f"{base}/tmpfiles.d/hil.conf": (source / "tmpfiles.conf").read_text(),
        f"{udev}/rules.d/70-hil.rules": (source / "udev.rules").read_text(),
    }


def network_files(bus: BusConfig, *, fd: bool) -> Files:
    """systemd-networkd's and udev's files for the rig's CAN interfaces; `fd` says whether its layout needs CAN FD."""
    files: Files = {}
    for channel in bus.channels:
        files |= _interface_files(bus, channel, fd=fd)
    return files


def _interface_files(bus: BusConfig, channel: str, *, fd: bool) -> Files:
    source = shipped("systemd") / "network"
    place = f"etc/systemd/network/80-hil-{channel}"
    if channel.startswith("vcan"):
        return {
            f"{place}.netdev": with_values((source / "vcan.netdev").read_text(), Name=channel),
            f"{place}.network": with_values((source / "vcan.network").read_text(), Name=channel),
        }
    rates: dict[str, object] = {"Name": channel, "BitRate": bus.bitrate}
    if fd:
        rates["DataBitRate"] = bus.data_bitrate
    network = (source / ("can-fd.network" if fd else "can-classic.network")).read_text()
    link = (source / "can.link").read_text()
    return {
        f"{place}.network": with_values(network, **rates),
        f"{place}.link": with_values(link, OriginalName=channel, TransmitQueueLength=bus.transmit_queue),
    }


def devices_of(rig: RigConfig) -> list[str]:
    """The systemd device units of the rig's CAN interfaces."""
    return [f"sys-subsystem-net-devices-{escape(channel)}.device" for channel in rig.bus.channels]


def unit_drop_in(rig: RigConfig, cpu: int | None = None) -> str:
    """The rig's own part of a unit: bound to its CAN devices and, where one is given, to a CPU."""
    devices = " ".join(devices_of(rig))
    lines = ["[Unit]", f"BindsTo={devices}", f"After={devices}"]
    if cpu is not None:
        lines += ["", "[Service]", f"CPUAffinity={cpu}"]
    return "\n".join([f"# written by `hil install` for rig {rig.name}", *lines, ""])


def control_cpu(rig: RigConfig, cpus: int) -> int | None:
    """The CPU of the control unit: the one of [timing], else the last of so many; None where there is but one."""
    if rig.timing.cpu >= 0:
        return rig.timing.cpu
    return cpus - 1 if cpus > 1 else None


def rig_links(rig: RigConfig, unit_directory: str, *, emulator: bool) -> Links:
    """Which units hil.target starts, and which a CAN device brings back when it is plugged in again."""
    bound = ["hil-control", "hil-emulator"] if emulator else ["hil-control"]
    started = [*bound, "hil-sidecar"]
    wants = [("hil.target", unit) for unit in started]
    wants += [(device, unit) for device in devices_of(rig) for unit in bound]
    return {
        f"etc/systemd/system/{wanting}.wants/{unit}@{rig.name}.service": f"/{unit_directory}/{unit}@.service"
        for wanting, unit in wants
    }


def rig_files(rig: RigConfig, *, fd: bool, emulator: bool) -> Files:
    """Everything but the rig file itself that belongs to one rig."""
    drop_ins = {"hil-control": unit_drop_in(rig, control_cpu(rig, os.cpu_count() or 1))}
    if emulator:
        drop_ins["hil-emulator"] = unit_drop_in(rig)
    files = {f"etc/systemd/system/{unit}@{rig.name}.service.d/rig.conf": text for unit, text in drop_ins.items()}
    return {**network_files(rig.bus, fd=fd), **files}


def _rig_text(source: Path, channel: str | None) -> tuple[str, RigConfig]:
    """The rig file's text (comments kept), with its channel replaced where one is given, and the rig parsed from it."""
    try:
        document = tomlkit.parse(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise RigError([f"{source}: {error.strerror}"]) from None
    except (tomlkit.exceptions.TOMLKitError, UnicodeDecodeError) as error:
        raise RigError([f"{source}: not a TOML document: {error}"]) from None
    if channel is not None:
        table = document.setdefault("bus", tomlkit.table())
        if "segments" in table:
            raise InstallError(f"--channel: {source} has bus.segments; name the channels there")
        table["channel"] = channel
    try:
        return tomlkit.dumps(document), build_rig(document.unwrap(), folder=source.parent)
    except RigError as error:
        raise error.of_file(source) from None


def _files_beside(rig: RigConfig, source: Path) -> Files:
    """The files that a rig needs beside it, by their names there: of its DBC layout, its law, its task.

    Raises InstallError for a path out of the rig file's folder: the installed one would not find it again.
    """
    files: Files = {}
    for key, name in named_files(rig).items():
        if Path(name).is_absolute():  # the same file wherever the rig file lies
            continue
        if ".." in Path(name).parts:
            raise InstallError(f"{key} = '{name}': must lie beside {source}, or be an absolute path")
        # DBC files come in any 8-bit encoding: keep the bytes
        files[name] = (source.parent / name).read_text(encoding="utf-8", errors="surrogateescape")
    return files


def _place_rig(root: Path, rig: RigConfig, files: Files, *, replace: bool) -> None:
    """Write the rig file and what belongs to it unless that would lose somebody's edits.

    They are the user's: no manifest lists them.
    """
    places = {root / RIGS / name: text for name, text in files.items()}
    for place, text in places.items():
        if place.exists() and place.read_text(encoding="utf-8", errors="surrogateescape") != text and not replace:
            raise InstallError(f"{place} exists and is different; edit it there and install it, or use --replace")
    for place, text in places.items():
        place.parent.mkdir(parents=True, exist_ok=True)
        write_text(place, text)
        place.chmod(0o644)


def _reload(root: Path, channels: Sequence[str] = ()) -> None:
    """Make the running system read the new files; starts and stops nothing.

    channels: interfaces to which udev is to apply their .link files (the transmit queue) now, if they are there.
    """
    if root != Path("/") or not Path("/run/systemd/system").is_dir():
        return
    devices = ["/dev/cpu_dma_latency", *(f"/sys/class/net/{channel}" for channel in channels)]
    present = [device for device in devices if Path(device).exists()]
    for command in (
        ["systemd-sysusers"],
        ["systemd-tmpfiles", "--create", "--prefix=/run/hil", "--prefix=/var/lib/hil", "--prefix=/etc/hil"],
        ["udevadm", "control", "--reload"],
        ["udevadm", "trigger", "--settle", "--action=add", *present],
        ["systemctl", "daemon-reload"],
        ["systemctl", "try-reload-or-restart", "systemd-networkd.service"],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"hil install: {' '.join(command)}: {done.stderr.strip()}", file=sys.stderr)


def _needs_fd(rig: RigConfig, base_dir: Path) -> bool:
    from hil.rig.bus_load import rig_layout  # slow, and only needed where a rig is installed

    return rig_layout(rig, base_dir).fd


def install_rig(
    source: Path, root: Path, *, channel: str | None, emulator: bool | None, replace: bool, executable: str
) -> RigConfig:
    """Put the rig file, its network files and unit links under `root`, and the shared units where no package did.

    emulator: also start the emulated stage; None: on vcan channels only. Raises RigError, InstallError, OSError.
    """
    text, rig = _rig_text(source, channel)
    if rig.bus.interface not in KERNEL_INTERFACES:
        raise InstallError(
            f"bus.interface = '{rig.bus.interface}': the control process runs on the kernel's CAN interfaces alone; "
            "`hil doctor` has the commands for the adapter's own driver"
        )
    if dashed := [name for name in rig.bus.channels if name.startswith("-")]:
        raise InstallError(f"bus.channel = '{dashed[0]}': `ip` takes it for an option; rename the interface")
    emulated = all(name.startswith("vcan") for name in rig.bus.channels) if emulator is None else emulator
    fd = _needs_fd(rig, source.parent)
    belongings = {f"{rig.name}.toml": text, **_files_beside(rig, source)}
    packaged = (root / _PACKAGED_TARGET).exists()
    manifest = read_manifest(root)
    shared = {} if packaged else system_files(executable, packaged=False)
    unit_directory = "usr/lib/systemd/system" if packaged else "etc/systemd/system"
    files = {**shared, **rig_files(rig, fd=fd, emulator=emulated)}
    links = rig_links(rig, unit_directory, emulator=emulated)
    if not replace:
        refuse_foreign(root, files, links, manifest)
    _place_rig(root, rig, belongings, replace=replace)
    remove(root, [path for path in manifest if f"@{rig.name}.service" in path], manifest)
    put(root, files, links, manifest)
    return rig


def _executable() -> str:
    """The `hil` that the units are to start: the one beside this interpreter."""
    beside = Path(sys.executable).parent / "hil"
    found = str(beside) if beside.exists() else shutil.which("hil")
    if not found:
        raise InstallError("no `hil` command beside this Python or on the path, for the units to start")
    return found


def _fail(error: Exception) -> None:
    print(f"hil: {error}", file=sys.stderr)
    if isinstance(error, PermissionError):
        print("hil: installing into the system needs root; --root DIR installs into a directory", file=sys.stderr)
    raise typer.Exit(1)


def install(
    rig: Annotated[Path, typer.Option(help="Rig file to install as /etc/hil/rigs/NAME.toml")],
    root: Annotated[Path, typer.Option(help="Install under this directory instead of /")] = Path("/"),
    channel: Annotated[str | None, typer.Option(help="Write this CAN channel into the installed rig file")] = None,
    emulator: Annotated[
        bool | None, typer.Option(help="Start the emulated stage as well [default: on vcan channels only]")
    ] = None,
    replace: Annotated[bool, typer.Option(help="Overwrite an installed rig file that differs")] = False,
) -> None:
    """Put the systemd units and a rig file in place. Starts nothing: systemctl start hil.target does."""
    try:
        installed = install_rig(
            rig, root, channel=channel, emulator=emulator, replace=replace, executable=_executable()
        )
    except (InstallError, OSError) as error:
        _fail(error)
    _reload(root, installed.bus.channels)
    print(f"rig {installed.name} on {', '.join(installed.bus.channels)}: {root / RIGS / installed.name}.toml")
    for place in masked_units(root, [*_UNITS, *(f"{unit}@{installed.name}.service" for unit in _PER_RIG)]):
        print(f"masked: {place}: systemd will not start it; systemctl unmask {Path(place).name}")
    print("start: systemctl start hil.target    at every boot: systemctl enable hil.target")


def uninstall(
    root: Annotated[Path, typer.Option(help="Where it was installed")] = Path("/"),
    purge: Annotated[bool, typer.Option(help="Remove the rig files as well")] = False,
) -> None:
    """Remove what `hil install` put in place; recordings in /var/lib/hil always stay."""
    try:
        if root == Path("/") and Path("/run/systemd/system").is_dir():
            # disabled too: systemctl's own link for the next boot is in no manifest
            subprocess.run(["systemctl", "disable", "--quiet", "--now", "hil.target"], check=False)
        removed, left = remove_all(root, purge=purge)
    except (InstallError, OSError) as error:
        _fail(error)
    _reload(root)
    print(f"{removed} files removed below {root}" if removed else f"nothing of hil is installed below {root}")
    for line in left:
        print(f"left: {line}")
