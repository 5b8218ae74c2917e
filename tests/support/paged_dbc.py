"""Drives of one identifier with pages, as many motors have them: their DBC file, and a binding that uses most keys."""

from typing import Any

TEXT = """VERSION ""

BU_: Host Drive

BO_ 2147484000 Asked0: 8 Host
 SG_ Order M : 0|8@1+ (1,0) [0|0] "" Drive
 SG_ Current m161 : 32|16@1- (0.01,0) [0|0] "A" Drive
 SG_ Limit m162 : 8|8@1+ (1,0) [0|0] "" Drive

BO_ 2147484001 Asked1: 8 Host
 SG_ Order M : 0|8@1+ (1,0) [0|0] "" Drive
 SG_ Current m161 : 32|16@1- (0.01,0) [0|0] "A" Drive
 SG_ Limit m162 : 8|8@1+ (1,0) [0|0] "" Drive

BO_ 1536 Told: 8 Drive
 SG_ Kind M : 0|8@1+ (1,0) [0|0] "" Host
 SG_ State : 8|4@1+ (1,0) [0|0] "" Host
 SG_ Axis m1M : 15|4@0+ (1,0) [0|0] "" Host
 SG_ Position0 m0 : 32|32@1- (1,0) [0|0] "" Host

BO_ 1537 Told1: 8 Drive
 SG_ Position : 7|32@0- (1,0) [0|0] "" Host
 SG_ State : 39|8@0+ (1,0) [0|0] "" Host

BO_ 1538 Told0: 8 Drive
 SG_ Kind M : 0|8@1+ (1,0) [0|0] "" Host
 SG_ State : 8|8@1+ (1,0) [0|0] "" Host
 SG_ Position m3 : 32|32@1- (1,0) [0|0] "" Host

BO_ 1539 Alive: 0 Host

BO_ 1540 Beat: 2 Host
 SG_ Toggle : 0|8@1+ (1,0) [0|0] "" Drive

BO_ 1541 Switch: 1 Host
 SG_ On : 0|8@1+ (1,0) [0|0] "" Drive

SG_MUL_VAL_ 2147484000 Current Order 161-161;
"""


LONG_BESIDE = """
BO_ 1542 Diagnostics: 48 Drive
 SG_ Code : 0|19@1+ (1,0) [0|0] "" Host

"""


def pair(message: str, signal: str, **more: Any) -> list[dict[str, Any]]:
    return [{"message": f"{message}{axis}", "signal": signal, **more} for axis in (0, 1)]


BINDING: dict[str, Any] = {
    "position": pair("Told", "Position"),
    "torque": pair("Asked", "Current", scale=0.05),
    "status": pair("Told", "State", enabled=[5]),
    "start": pair("Asked", "Order", value=0x88),
    "stop": pair("Asked", "Order", value=0x81),
    "constant": pair("Asked", "Limit", value=7),
    "on_change": ["Asked0.Limit", "Asked1.Limit", "Alive"],
    "periodic": [{"message": "Beat", "period_s": 0.005}],
    "remote": ["Told0"],
}


def bound(**changes: Any) -> dict[str, Any]:
    binding = {**BINDING, "constant": [*BINDING["constant"], {"message": "Beat", "signal": "Toggle", "value": 1}]}
    return {**binding, **changes}
