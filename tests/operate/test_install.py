"""`hil install` into a directory: what lands where, what is never overwritten, and that uninstall leaves nothing."""

import configparser
import hashlib
import json
import re
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.operate.install import (
    InstallError,
    escape,
    install_rig,
    network_files,
    system_files,
    with_values,
)
from hil.operate.installed import read_manifest, remove_all
from hil.rig.file import load_rig, rig_hash
from hil.rig.schema import RigError
from tests.support.paths import RIGS, ROOT

MICROSCOPE = RIGS / "microscope.toml"
EMPTY = hashlib.sha256(b"").hexdigest()


def put(root: Path, rig: Path = MICROSCOPE, **options):
    chosen = {"channel": None, "emulator": None, "replace": False, "executable": "/opt/hil/bin/hil", **options}
    return install_rig(rig, root, **chosen)


def read_unit(path: Path) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str
    parser.read(path)
    return parser


def contents(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_symlink() or path.is_file()}


def test_a_rig_on_a_real_bus_gets_its_bit_rates_its_queue_and_no_emulator(tmp_path):
    put(tmp_path)
    network = read_unit(tmp_path / "etc/systemd/network/80-hil-can0.network")
    assert dict(network["CAN"]) == {"BitRate": "1000000", "DataBitRate": "5000000", "FDMode": "yes"}
    link = read_unit(tmp_path / "etc/systemd/network/80-hil-can0.link")
    assert link["Link"]["TransmitQueueLength"] == str(load_rig(MICROSCOPE).bus.transmit_queue)
    assert not any("emulator@microscope" in name for name in contents(tmp_path))


def test_a_classic_layout_gets_a_classic_interface(tmp_path):
    rig = tmp_path / "classic.toml"
    text = MICROSCOPE.read_text().replace('protocol = "stage_fd"', 'protocol = "stage_classic"\nbitrate = 500000')
    rig.write_text(text)
    put(tmp_path / "root", rig)
    network = read_unit(tmp_path / "root/etc/systemd/network/80-hil-can0.network")
    assert dict(network["CAN"]) == {"BitRate": "500000"}


def test_a_rig_whose_drives_a_dbc_file_describes_brings_that_file_along(tmp_path):
    put(tmp_path, RIGS / "paper-dbc.toml")
    rig = load_rig(tmp_path / "etc/hil/rigs/paper-dbc.toml")
    installed = tmp_path / "etc/hil/rigs" / rig.bus.protocol.removeprefix("dbc:")
    assert installed.read_bytes() == (RIGS / "example_drive.dbc").read_bytes()
    installed.write_bytes(installed.read_bytes() + b'CM_ "B\xfcro";\n')  # an edit, in the encoding of its editor
    with pytest.raises(InstallError, match=r"example_drive\.dbc"):
        put(tmp_path, RIGS / "paper-dbc.toml")
    put(tmp_path, tmp_path / "etc/hil/rigs/paper-dbc.toml")
    assert installed.read_bytes().endswith(b'"B\xfcro";\n')


def test_a_rig_with_a_law_an_estimator_a_task_and_frames_of_its_own_brings_their_files_along(tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    for file in ("laws/lqr.py", "tasks/rose.py", "layouts/maker.py", "estimators/luenberger.py"):
        shutil.copy(ROOT / "examples" / file, mine)
    text = MICROSCOPE.read_text()
    text = re.sub(r"(?ms)^\[law\].*?(?=^\[(?!law))", '[law]\nname = "./lqr.py:Lqr"\n\n', text)
    text = re.sub(r"(?ms)^\[task\].*?(?=^\[(?!task))", '[task]\nkind = "./rose.py:Rose"\naxes = ["x", "y"]\n\n', text)
    text = text.replace("[estimator]\n", '[estimator]\nname = "./luenberger.py:Luenberger"\n')
    text = text.replace('protocol = "stage_fd"', 'protocol = "./maker.py:Maker"')
    (mine / "mine.toml").write_text(text.replace('name = "microscope"', 'name = "mine"'))
    put(tmp_path / "root", mine / "mine.toml")
    installed = tmp_path / "root/etc/hil/rigs"
    assert rig_hash(load_rig(installed / "mine.toml")) == rig_hash(load_rig(mine / "mine.toml"))
    assert {path.name for path in installed.iterdir()} >= {
        "mine.toml",
        "lqr.py",
        "rose.py",
        "maker.py",
        "luenberger.py",
    }


@pytest.mark.parametrize(("file", "error"), [("missing.dbc", RigError), ("../elsewhere.dbc", InstallError)])
def test_a_dbc_file_that_cannot_be_brought_along_installs_nothing(tmp_path, file, error):
    rigs = tmp_path / "rigs"
    rigs.mkdir()
    (tmp_path / "elsewhere.dbc").write_bytes((RIGS / "example_drive.dbc").read_bytes())
    rig = rigs / "mine.toml"
    rig.write_text((RIGS / "paper-dbc.toml").read_text().replace("example_drive.dbc", file))
    with pytest.raises(error, match=file):
        put(tmp_path / "root", rig)
    assert not (tmp_path / "root").exists()


def test_a_controller_that_went_bus_off_is_never_restarted_by_the_network_configuration():
    for fd in (True, False):
        for text in network_files(load_rig(MICROSCOPE).bus, fd=fd).values():
            assert not any(line.startswith("RestartSec") for line in text.splitlines())


def test_a_rig_on_a_virtual_bus_brings_the_bus_and_the_emulated_stage(tmp_path):
    put(tmp_path, channel="vcan0")
    assert load_rig(tmp_path / "etc/hil/rigs/microscope.toml").bus.channel == "vcan0"
    assert read_unit(tmp_path / "etc/systemd/network/80-hil-vcan0.netdev")["NetDev"]["Kind"] == "vcan"
    wants = tmp_path / "etc/systemd/system/hil.target.wants"
    assert {link.name for link in wants.iterdir()} == {
        f"hil-{part}@microscope.service" for part in ("control", "emulator", "sidecar")
    }


def test_the_control_unit_is_bound_to_its_can_device_and_comes_back_with_it(tmp_path):
    put(tmp_path, channel="can-left")
    device = r"sys-subsystem-net-devices-can\x2dleft.device"
    drop_in = read_unit(tmp_path / "etc/systemd/system/hil-control@microscope.service.d/rig.conf")
    assert drop_in["Unit"]["BindsTo"] == device
    link = tmp_path / f"etc/systemd/system/{device}.wants/hil-control@microscope.service"
    assert (tmp_path / str(link.readlink()).lstrip("/")).exists()


def test_units_start_the_hil_that_installed_them(tmp_path):
    put(tmp_path)
    unit = read_unit(tmp_path / "etc/systemd/system/hil-control@.service")
    assert unit["Service"]["ExecStart"] == "/opt/hil/bin/hil run /etc/hil/rigs/%i.toml"
    assert unit["Service"]["RestartPreventExitStatus"] == "77 78"
    assert unit["Service"]["User"] == "hil"


def test_where_a_package_brought_the_units_they_are_not_shadowed(tmp_path):
    for name, content in system_files("/usr/bin/hil", packaged=True).items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    put(tmp_path)
    assert not (tmp_path / "etc/systemd/system/hil-control@.service").exists()


def test_an_edited_rig_file_is_not_overwritten_unless_asked(tmp_path):
    put(tmp_path)
    installed = tmp_path / "etc/hil/rigs/microscope.toml"
    installed.write_text(installed.read_text().replace("rate_hz = 1000", "rate_hz = 500"))
    with pytest.raises(InstallError, match="--replace"):
        put(tmp_path)
    assert load_rig(installed).rate_hz == 500
    put(tmp_path, installed)  # the edited file itself: what the page says to do after an edit
    assert load_rig(installed).rate_hz == 500
    put(tmp_path, replace=True)
    assert load_rig(installed).rate_hz == 1000


def test_uninstall_takes_away_all_but_the_rig_files(tmp_path):
    put(tmp_path, channel="vcan0")
    designs = tmp_path / "var/cache/hil/designs"  # the service's
    designs.mkdir(parents=True)
    (designs / "one").touch()
    _, left = remove_all(tmp_path, purge=False)
    assert contents(tmp_path) == {"etc/hil/rigs/microscope.toml"}
    assert len(left) == 1
    assert remove_all(tmp_path, purge=True) == (1, [])
    assert contents(tmp_path) == set()


def test_uninstall_keeps_what_somebody_changed_and_says_so(tmp_path):
    put(tmp_path)
    network = tmp_path / "etc/systemd/network/80-hil-can0.network"
    network.write_text(network.read_text() + "# ours\n")
    assert any("80-hil-can0.network" in line for line in remove_all(tmp_path, purge=True)[1])
    assert contents(tmp_path) == {"etc/systemd/network/80-hil-can0.network"}


def test_a_rig_file_with_a_mistake_installs_nothing(tmp_path):
    rig = tmp_path / "bad.toml"
    rig.write_text(MICROSCOPE.read_text().replace("rate_hz = 1000", "rate_hz = -1"))
    with pytest.raises(RigError, match="rate_hz"):
        put(tmp_path / "root", rig)
    assert not (tmp_path / "root").exists()


@pytest.mark.parametrize(("name", "escaped"), [("can0", "can0"), ("can-1", r"can\x2d1"), ("a.b_c", "a.b_c")])
def test_names_are_escaped_as_systemd_does(name, escaped):
    assert escape(name) == escaped


def test_a_key_that_is_not_in_the_file_is_an_error_and_not_dropped():
    with pytest.raises(InstallError, match="BitRate"):
        with_values("[CAN]\n", BitRate=1)


def test_a_bus_that_is_none_of_the_kernels_is_not_installed(tmp_path: Path):
    rig = tmp_path / "rig.toml"
    rig.write_text(MICROSCOPE.read_text().replace('interface = "auto"', 'interface = "slcan"', 1))
    with pytest.raises(InstallError, match="the kernel's CAN interfaces alone"):
        put(tmp_path / "root", rig)


@pytest.mark.parametrize("entry", ["../outside", "/etc/hostname", "etc/../../outside", "linked/file"])
def test_a_manifest_that_leads_out_of_its_root_removes_nothing(tmp_path: Path, entry: str) -> None:
    root = tmp_path / "root"
    put(root)
    (root / "linked").symlink_to(tmp_path)
    for outside in (tmp_path / "outside", tmp_path / "file"):
        outside.write_text("")
    manifest = root / "etc/hil/installed.json"
    manifest.write_text(json.dumps({**json.loads(manifest.read_text()), entry: EMPTY}))
    before = contents(root)
    with pytest.raises(InstallError, match=re.escape(repr(entry)) + " leads out of"):
        remove_all(root, purge=True)
    assert contents(root) == before
    assert (tmp_path / "outside").exists()
    assert (tmp_path / "file").exists()


@pytest.mark.parametrize("text", ["[]", '{"a": 1}', "{", '"x"'])
def test_a_manifest_that_is_none_is_refused_by_name(tmp_path: Path, text: str) -> None:
    put(tmp_path)
    (tmp_path / "etc/hil/installed.json").write_text(text)
    with pytest.raises(InstallError, match=r"installed\.json: "):
        read_manifest(tmp_path)


def test_a_file_of_the_administrators_is_never_overwritten_unasked(tmp_path: Path) -> None:
    theirs = tmp_path / "etc/systemd/system/hil-control@.service"
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes(b"# ours, \xff\n")
    with pytest.raises(InstallError, match=r"hil-control@\.service: not written by `hil install`"):
        put(tmp_path)
    assert contents(tmp_path) == {"etc/systemd/system/hil-control@.service"}, "nothing else is installed either"
    put(tmp_path, replace=True)
    assert b"ExecStart" in theirs.read_bytes()


def test_a_link_of_the_administrators_is_not_written_through(tmp_path: Path) -> None:
    elsewhere = tmp_path / "theirs.service"
    elsewhere.write_text("theirs")
    unit = tmp_path / "root/etc/systemd/system/hil.target"
    unit.parent.mkdir(parents=True)
    unit.symlink_to(elsewhere)
    with pytest.raises(InstallError, match=r"hil\.target"):
        put(tmp_path / "root")
    put(tmp_path / "root", replace=True)
    assert elsewhere.read_text() == "theirs"
    assert not unit.is_symlink()


def test_what_an_earlier_version_installed_is_renewed(tmp_path: Path) -> None:
    put(tmp_path)
    put(tmp_path, executable="/opt/newer/bin/hil")
    unit = read_unit(tmp_path / "etc/systemd/system/hil-control@.service")
    assert unit["Service"]["ExecStart"].startswith("/opt/newer/bin/hil")


def test_a_masked_unit_stays_masked_and_is_told(tmp_path: Path) -> None:
    mask = tmp_path / "etc/systemd/system/hil-page.service"
    mask.parent.mkdir(parents=True)
    mask.symlink_to("/dev/null")
    done = CliRunner().invoke(build_app("install"), ["install", "--rig", str(MICROSCOPE), "--root", str(tmp_path)])
    assert done.exit_code == 0
    assert f"masked: {mask}: systemd will not start it; systemctl unmask hil-page.service\n" in done.output
    assert mask.readlink() == Path("/dev/null")
    removed, left = remove_all(tmp_path, purge=True)
    assert removed > 10
    assert left == []
    assert contents(tmp_path) == {"etc/systemd/system/hil-page.service"}


def test_a_channel_that_reads_as_an_option_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InstallError, match="'-can0': `ip` takes it for an option"):
        put(tmp_path, channel="-can0")
    assert contents(tmp_path) == set()


def test_purge_says_what_it_leaves(tmp_path: Path) -> None:
    put(tmp_path)
    (tmp_path / "etc/hil/zenoh.pem").write_text("theirs")
    (tmp_path / "var/lib/hil").mkdir(parents=True)
    (tmp_path / "var/lib/hil/run.mcap").write_text("a run")
    _, left = remove_all(tmp_path, purge=True)
    assert left == ["/etc/hil/zenoh.pem: not ours", "/var/lib/hil: recordings, which are yours to remove"]
    assert contents(tmp_path) == {"etc/hil/zenoh.pem", "var/lib/hil/run.mcap"}


def test_uninstall_says_how_much_it_removed_or_that_there_was_nothing(tmp_path: Path) -> None:
    put(tmp_path)
    words = ["uninstall", "--root", str(tmp_path), "--purge"]
    first, second = (CliRunner().invoke(build_app("uninstall"), words) for _ in range(2))
    assert re.fullmatch(r"\d\d files removed below \S+\n", first.output)
    assert second.output == f"nothing of hil is installed below {tmp_path}\n"
