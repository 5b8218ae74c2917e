"""CAN adapters: which of the kernel's drivers serve them, what is plugged in, and the commands that set each up.

Identifiers are those of the kernel's own drivers (drivers/net/can/usb). An adapter whose maker has a driver of its own
in user space can be used by tools without any of this: docs/drives.md.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

NET, USB = Path("/sys/class/net"), Path("/sys/bus/usb/devices")


class Adapter(NamedTuple):
    """A kind of adapter. driver: the kernel's module. serial: it is a serial line, and slcand makes an interface of it.

    note: what else to know, for people.
    """

    name: str
    driver: str
    serial: bool = False
    note: str = ""


_SLOW = "every frame goes through a serial line as text, classic CAN alone: for bring-up, not for a control loop"
_CLASSIC = "classic CAN alone"
DRIVERS = {  # by the name in /sys/class/net/*/device/driver
    "peak_usb": Adapter("PEAK PCAN-USB", "peak_usb"),
    "peak_pci": Adapter("PEAK PCAN-PCI", "peak_pci", note=_CLASSIC),
    "peak_pciefd": Adapter("PEAK PCAN-PCI Express FD", "peak_pciefd"),
    "kvaser_usb": Adapter("Kvaser USB", "kvaser_usb"),
    "kvaser_pci": Adapter("Kvaser PCIcan", "kvaser_pci", note=_CLASSIC),
    "kvaser_pciefd": Adapter("Kvaser PCIEcan", "kvaser_pciefd"),
    "gs_usb": Adapter("candleLight (gs_usb)", "gs_usb", note="CAN FD only where the adapter's own controller has it"),
    "mcp251xfd": Adapter("MCP2517FD or MCP2518FD on SPI", "mcp251xfd"),
    "mcp251x": Adapter(
        "MCP2515 on SPI", "mcp251x", note=_CLASSIC + "; two receive buffers: frames are lost under load"
    ),
    "m_can": Adapter("Bosch M_CAN", "m_can"),
    "usb_8dev": Adapter("8devices USB2CAN", "usb_8dev", note=_CLASSIC),
    "ems_usb": Adapter("EMS CPC-USB", "ems_usb", note=_CLASSIC),
    "esd_usb": Adapter("esd CAN-USB", "esd_usb"),
}
_USB = {  # vendor -> product, "" for every other of the vendor -> name and driver
    "0c72": {
        "000c": Adapter("PEAK PCAN-USB", "peak_usb", note=_CLASSIC),
        "000d": Adapter("PEAK PCAN-USB Pro", "peak_usb", note=_CLASSIC),
        "0011": Adapter("PEAK PCAN-USB Pro FD", "peak_usb"),
        "0012": Adapter("PEAK PCAN-USB FD", "peak_usb"),
        "0013": Adapter("PEAK PCAN-Chip USB", "peak_usb"),
        "0014": Adapter("PEAK PCAN-USB X6", "peak_usb"),
    },
    "0bfd": {"": DRIVERS["kvaser_usb"]},
    "1d50": {"606f": DRIVERS["gs_usb"]},
    "1209": {"2323": DRIVERS["gs_usb"], "ca01": DRIVERS["gs_usb"]},
    "1cd2": {"606f": DRIVERS["gs_usb"]},
    "16d0": {
        "10b8": DRIVERS["gs_usb"],
        "0f30": DRIVERS["gs_usb"],
        "117e": Adapter("CANable 2 with slcan firmware", "slcan", serial=True, note=_SLOW),
    },
    "ad50": {"60c4": Adapter("CANable with slcan firmware", "slcan", serial=True, note=_SLOW)},
    "0403": {"ffa8": Adapter("Lawicel CANUSB", "slcan", serial=True, note=_SLOW)},
    "0483": {"1234": DRIVERS["usb_8dev"]},
    "12fd": {"2200": DRIVERS["ems_usb"]},
    "0ab4": {"0010": DRIVERS["esd_usb"]},
}


class Plugged(NamedTuple):
    """A USB adapter on this machine. product: as it calls itself. interfaces: of the kernel, that it has. tty: of a
    serial one, or empty.
    """

    adapter: Adapter
    product: str
    interfaces: list[str]
    tty: str


def plugged(usb: Path = USB) -> list[Plugged]:
    """The USB adapters that are known, in the order of their ports."""
    return list(_plugged(usb))


def _plugged(usb: Path) -> Iterator[Plugged]:
    try:
        devices = sorted(usb.iterdir())
    except OSError:
        return
    for device in devices:
        products = _USB.get(_read(device / "idVendor"), {})
        adapter = products.get(_read(device / "idProduct"), products.get(""))
        if adapter is not None:
            interfaces = sorted(path.name for path in device.glob("*:*/net/*"))
            tty = next((path.name for path in sorted(device.glob("*:*/tty/*"))), "")
            yield Plugged(adapter, _read(device / "product"), interfaces, tty)


def adapter_of(interface: str, net: Path = NET) -> Adapter | None:
    """What serves a CAN interface of the kernel; None for a virtual one, and for drivers not known here."""
    try:
        driver = (net / interface / "device" / "driver").resolve(strict=True).name
    except OSError:
        return None
    usb = (net / interface / "device").resolve().parent
    products = _USB.get(_read(usb / "idVendor"), {})
    exact = products.get(_read(usb / "idProduct"))
    return exact or DRIVERS.get(driver) or Adapter(driver, driver)


def set_up(interface: str, adapter: Adapter | None) -> str:
    """The commands, as root, that bring an interface up at 1 and 5 Mbit/s; `hil install` does it for good."""
    if adapter is None and interface.startswith(("vcan", "slcan")):
        return f"ip link set {interface} up"
    classic = adapter is not None and adapter.note.startswith(_CLASSIC)
    rates = "bitrate 1000000" if classic else "bitrate 1000000 dbitrate 5000000 fd on"
    return (
        f"ip link set {interface} type can {rates} && ip link set {interface} txqueuelen 16 && "
        f"ip link set {interface} up"
    )


def make_interface(found: Plugged) -> str:
    """The commands, as root, that give an adapter an interface where it has none."""
    if found.adapter.serial:
        tty = found.tty or "ttyACM0"
        return f"slcand -o -c -s8 /dev/{tty} can0 && ip link set can0 up (s8: 1 Mbit/s; Debian: apt install can-utils)"
    return f"modprobe {found.adapter.driver}, then unplug it and plug it in again"


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
