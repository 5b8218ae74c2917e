"""Which rigs may let an ODrive home by itself, and what is refused."""

from pathlib import Path
from typing import Any

import pytest

from drivers.protocols.base import LayoutError
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig
from tests.support.odrive_homing import FILE, rig_of, write_endpoints


@pytest.mark.parametrize(
    ("case", "says"),
    [
        ({"home": {"method": 17}}, "axes.x.home.method = 17: allowed 11"),
        ({"binding": {"read_back": [], "endpoints": ""}}, "axes.x.home.method: bus.dbc.endpoints is not stated"),
        (
            {"weight": -2.0, "home": {"force": 4.5}},
            "model.gravity = -2 exceeds coulomb = 1.146; expected drives.brake = true",
        ),
    ],
)
def test_a_rig_that_cannot_home_so_is_refused(case: dict[str, Any], says: str, tmp_path: Path) -> None:
    with pytest.raises(LayoutError) as refused:
        host_layout(rig_of(tmp_path, **case), tmp_path)
    assert says in str(refused.value)


def dbc_of(rig: RigConfig) -> dict[str, Any]:
    return rig.model_dump(mode="json", exclude_defaults=True)["bus"]["dbc"]  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (lambda dbc: {"constant": dbc["constant"][2:], "on_change": [*dbc["on_change"][:2], *dbc["on_change"][3:]]},
         "bus.dbc.constant has no Set_Controller_Mode (identifier node * 32 + 11) for axis 0"),
        (lambda dbc: {"read_back": dbc["read_back"][5:]}, "bus.dbc.read_back has no entry with axis = 0"),
        (lambda dbc: {"enable": [dbc["enable"][0] | {"on": 9}, dbc["enable"][1]]},
         "bus.dbc.enable[0] is no Set_Axis_State (identifier node * 32 + 7) with on = 8 and off = 1"),
        (lambda dbc: {"status": [dbc["status"][0] | {"message": "TxSdo0", "signal": "Control_Mode"}, dbc["status"][1]]},
         "bus.dbc.status[0] is not in the Heartbeat"),
    ],
)  # fmt: skip
def test_a_binding_that_is_not_the_makers_is_refused(changed: Any, says: str, tmp_path: Path) -> None:
    rig = rig_of(tmp_path, binding=changed(dbc_of(rig_of(tmp_path))))
    with pytest.raises(LayoutError) as refused:
        host_layout(rig, tmp_path)
    assert f"axes.x.home.method: {says}" in str(refused.value)


@pytest.mark.parametrize("path", ["axis0.min_endstop.state", "axis0.config.torque_soft_min"])
def test_a_firmware_that_cannot_be_bounded_is_refused(path: str, tmp_path: Path) -> None:
    rig = rig_of(tmp_path)
    write_endpoints(tmp_path, without=path)
    with pytest.raises(LayoutError) as refused:
        host_layout(rig, tmp_path)
    assert f"{FILE} has no {path!r} with a number and a type" in str(refused.value)
