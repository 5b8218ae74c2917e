"""The doctor looks without changing anything, and says what to do."""

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.operate import doctor, machine
from tests.vm.doctor_truth import untruths


def interface(net, name, kind="280", flags="0x1003", mtu="72"):
    folder = net / name
    folder.mkdir(parents=True)
    for key, value in {"type": kind, "flags": flags, "mtu": mtu, "tx_queue_len": "16"}.items():
        (folder / key).write_text(value + "\n")


@pytest.fixture
def with_socketcan(monkeypatch):
    class Socket:
        def close(self):
            pass

    monkeypatch.setattr(doctor.socket, "socket", lambda *_: Socket())


@pytest.mark.long
def test_what_it_says_of_this_machine_is_true_by_other_witnesses():
    """Without CAN here, or with: the VM lane asks the same in guests that have it."""
    assert untruths([finding._asdict() for finding in doctor.examine()]) == []


def test_only_can_interfaces_are_listed_and_each_is_judged(tmp_path, with_socketcan):
    interface(tmp_path, "can0")
    interface(tmp_path, "can1", flags="0x1002")
    interface(tmp_path, "vcan0", mtu="16")
    interface(tmp_path, "eth0", kind="1")
    found = {f.topic: f for f in doctor.can_findings(tmp_path, tmp_path / "usb")}
    assert list(found) == ["CAN can0", "CAN can1", "CAN vcan0"]
    assert found["CAN can0"].level == "ok"
    assert "transmit queue 16" in found["CAN can0"].detail
    assert (found["CAN can1"].level, found["CAN can1"].detail) == ("warn", "down")
    assert "ip link set can1 up" in found["CAN can1"].advice
    assert found["CAN vcan0"].level == "note"
    assert "classic" in found["CAN vcan0"].detail


def usb_device(usb, port, vendor, product, *, name="", net="", tty=""):
    """A device as the kernel shows it below /sys/bus/usb/devices."""
    device = usb / port
    (device / f"{port}:1.0").mkdir(parents=True)
    for key, value in {"idVendor": vendor, "idProduct": product, "product": name}.items():
        (device / key).write_text(value + "\n")
    for kind, child in (("net", net), ("tty", tty)):
        if child:
            (device / f"{port}:1.0" / kind / child).mkdir(parents=True)
    return device / f"{port}:1.0"


def served(net, name, device, driver):
    """The interface belongs to this device and driver."""
    (net / name / "device").symlink_to(device)
    (net.parent / "drivers" / driver).mkdir(parents=True, exist_ok=True)
    (device / "driver").symlink_to(net.parent / "drivers" / driver)


@pytest.mark.parametrize(
    ("vendor", "product", "driver", "said", "command"),
    [
        ("0c72", "0012", "peak_usb", "PEAK PCAN-USB FD (driver peak_usb)", "dbitrate 5000000 fd on"),
        ("0c72", "000c", "peak_usb", "PEAK PCAN-USB (driver peak_usb)", "type can bitrate 1000000 && "),
        ("0bfd", "0123", "kvaser_usb", "Kvaser USB (driver kvaser_usb)", "fd on"),
        ("1d50", "606f", "gs_usb", "candleLight (gs_usb) (driver gs_usb)", "fd on"),
        ("9999", "0001", "new_usb", "new_usb (driver new_usb)", "fd on"),
    ],
)
def test_an_interface_that_is_down_comes_with_its_adapter_and_commands(
    tmp_path, with_socketcan, vendor, product, driver, said, command
):
    net, usb = tmp_path / "net", tmp_path / "usb"
    interface(net, "can0", flags="0x1002")
    served(net, "can0", usb_device(usb, "1-2", vendor, product, net="can0"), driver)
    (finding,) = doctor.can_findings(net, usb)
    assert (finding.topic, finding.level) == ("CAN can0", "warn")
    assert said in finding.detail
    assert command in finding.advice
    assert finding.advice.endswith("ip link set can0 up")
    (net / "can0" / "flags").write_text("0x1003\n")
    (finding,) = doctor.can_findings(net, usb)
    assert finding.level == "ok"
    assert said in finding.detail


def test_an_adapter_without_an_interface_is_told_how_to_get_one(tmp_path, with_socketcan):
    usb = tmp_path / "usb"
    usb_device(usb, "1-1", "ad50", "60c4", name="CANable", tty="ttyACM3")
    usb_device(usb, "1-2", "0c72", "0012", name="PCAN-USB FD")
    usb_device(usb, "1-3", "046d", "c077", name="Mouse")
    _, serial, peak = doctor.can_findings(tmp_path / "net", usb)
    assert "slcand -o -c -s8 /dev/ttyACM3 can0" in serial.advice
    assert "not for a control loop" in serial.detail
    assert peak.topic == "adapter PEAK PCAN-USB FD"
    assert "modprobe peak_usb" in peak.advice


def test_a_kernel_without_can_is_a_note_with_the_way_out(monkeypatch):
    def refuse(*_):
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr(doctor.socket, "socket", refuse)
    (finding,) = doctor.can_findings(usb=Path("/nowhere"))
    assert finding.level == "note"
    assert "local bus" in finding.detail
    assert "AF_CAN" in finding.advice


def test_no_interface_tells_how_to_make_one(tmp_path, with_socketcan):
    (finding,) = doctor.can_findings(tmp_path, tmp_path / "usb")
    assert "vcan" in finding.advice


def test_the_kernel_is_judged_by_what_it_says(tmp_path):
    proc, kernel = tmp_path / "proc", tmp_path / "kernel"
    (proc / "sys/kernel").mkdir(parents=True)
    kernel.mkdir()
    (proc / "sys/kernel/sched_rt_runtime_us").write_text("0\n")
    plain = {f.topic: f for f in doctor.kernel_findings(proc, kernel)}
    assert plain["kernel"].level == "note"
    assert plain["throttling"].level == "warn"
    (kernel / "realtime").write_text("1\n")
    (proc / "sys/kernel/sched_rt_runtime_us").write_text("950000\n")
    better = {f.topic: f for f in doctor.kernel_findings(proc, kernel)}
    assert better["kernel"].level == better["throttling"].level == "ok"


def test_devices_that_interrupt_the_loops_core_are_named(tmp_path: Path):
    """A disk whose completions run on the loop's core makes ticks late that no priority can protect."""
    (tmp_path / "interrupts").write_text(
        "           CPU0       CPU1\n"
        " 24:          7          0 IR-PCI-MSIX-0000:00:14.0   0-edge      xhci_hcd\n"
        " 36:          0       2423 IR-PCI-MSIX-0000:01:00.0   1-edge      nvme0q1\n"
        " 37:          0         13 IR-PCI-MSIX-0000:02:00.0   1-edge      eth0\n"
        "LOC:       1785       2946   Local timer interrupts\n"
        "ERR:          0\n"
    )
    for number, core in (("24", "0"), ("36", "1"), ("37", "1")):
        (tmp_path / "irq" / number).mkdir(parents=True)
        (tmp_path / "irq" / number / "effective_affinity_list").write_text(core + "\n")
    disk = doctor.interrupts_finding(1, tmp_path)
    assert disk.level == "note"
    assert "nvme0q1 (36: 2423 so far)" in disk.detail
    assert "eth0" not in disk.detail  # hardly ever
    assert "smp_affinity_list" in disk.advice
    (tmp_path / "irq/36/effective_affinity_list").write_text("0\n")
    assert doctor.interrupts_finding(1, tmp_path).level == "ok"
    assert doctor.interrupts_finding(5, tmp_path).level == "ok"  # no such core: nothing to say


@pytest.mark.long
def test_real_time_is_tried_without_leaving_a_trace_in_this_process():
    before = (os.sched_getscheduler(0), os.sched_getaffinity(0), Path("/proc/self/status").read_text().count("VmLck"))
    findings = doctor.realtime_findings()
    assert [f.topic for f in findings] == ["core", "collector", "memory", "dma_latency", "priority"]
    assert all(f.advice for f in findings if f.level == "warn")
    after = (os.sched_getscheduler(0), os.sched_getaffinity(0), Path("/proc/self/status").read_text().count("VmLck"))
    assert before == after


def test_memory_and_disk_are_told_apart():
    assert doctor.in_memory(Path("/dev/shm"))
    assert not doctor.in_memory(Path("/proc"))
    assert not doctor.in_memory(Path("/does/not/exist"))


@pytest.mark.parametrize(
    ("stated", "mapped", "lacks"),
    [
        ("'--enable-optimizations' '--with-lto'", "/usr/bin/python3.11", []),
        ("'--enable-shared'", "/usr/lib/libpython3.11.so.1.0", ["shared library", "profile", "link-time optimization"]),
        ("'--enable-optimizations'", "/usr/bin/python3.11", ["link-time optimization"]),
    ],
)
def test_how_python_was_built_is_said(tmp_path, monkeypatch, stated, mapped, lacks):
    maps = tmp_path / "maps"
    maps.write_text(f"7f19fdc00000-7f19fdcf5000 r--p 00000000 fe:00 26933  {mapped}\n")
    monkeypatch.setattr(machine.sysconfig, "get_config_var", {"CONFIG_ARGS": stated}.get)
    found = machine.python_lacks(maps)
    assert len(found) == len(lacks)
    assert all(text in told for text, told in zip(lacks, found, strict=True))
    finding = doctor.python_finding(found)
    assert (finding.level == "ok") is (not lacks)
    assert all(told in finding.detail for told in found)


def test_a_missing_tool_comes_with_the_way_to_get_it():
    assert doctor.tool_finding("cc", "how", which=lambda _: "/usr/bin/cc").level == "ok"
    missing = doctor.tool_finding("cyclictest", "how", which=lambda _: None)
    assert (missing.level, missing.advice) == ("note", "how")


def test_the_command_prints_json_and_fails_only_when_asked_to(monkeypatch):
    runner = CliRunner()
    app = build_app("doctor")
    monkeypatch.setattr(doctor, "examine", lambda: [doctor.Finding("cores", "warn", "one", "another core")])
    shown = runner.invoke(app, ["doctor", "--json"])
    assert shown.exit_code == 0
    assert json.loads(shown.stdout)["findings"][0]["advice"] == "another core"
    assert runner.invoke(app, ["doctor", "--strict"]).exit_code == 1
    table = runner.invoke(app, ["doctor"])
    assert table.exit_code == 0
    assert "another core" in table.stdout


@pytest.mark.parametrize(
    ("watch", "commands", "level", "said"),
    [
        (["tcp/127.0.0.1:7447"], "", "ok", "nobody from elsewhere. Watch, no more: tcp/127.0.0.1:7447: every account"),
        (["tls/0.0.0.0:7447"], "0.0.0.0:7448", "ok", "operators' certificates at 0.0.0.0:7448"),
        (["tcp/0.0.0.0:7447"], "", "warn", "everybody who reaches this machine"),
    ],
)
def test_it_says_who_can_connect_and_do_what(
    tmp_path: Path, watch: list[str], commands: str, level: str, said: str
) -> None:
    (tmp_path / "access.json").write_text(json.dumps({"watch": watch, "commands": commands}))
    finding = doctor.access_finding("rig", tmp_path)
    assert finding.level == level
    assert said in finding.detail
    assert f"uid {os.getuid()} and root here" in finding.detail


def test_of_a_sidecar_that_left_no_word_it_says_so(tmp_path: Path) -> None:
    assert doctor.access_finding("rig", tmp_path).level == "note"
