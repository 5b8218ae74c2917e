"""Emergency messages in words: error codes (CiA 301, table 26; CiA 402-2, annex) and the error register (1001h)."""

from drivers.families.cia402.cia301 import EMCY

_CODES = {
    0x2310: "continuous over-current at the output",
    0x2320: "short circuit or earth leakage at the output",
    0x3210: "over-voltage of the DC link",
    0x3220: "under-voltage of the DC link",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x6320: "parameter error",
    0x7121: "motor blocked",
    0x7305: "incremental encoder 1",
    0x7320: "position sensor",
    0x8110: "CAN overrun",
    0x8120: "CAN in error passive",
    0x8130: "heartbeat or life guarding: the host fell silent",
    0x8140: "recovered from bus-off",
    0x8210: "PDO not processed: too short",
    0x8220: "PDO too long",
    0x8240: "unexpected length of SYNC",
    0x8250: "RPDO timed out",
    0x8611: "following error",
    0x8612: "reference limit",
}
_CLASSES = (  # mask, value: the first that fits; a class of two digits before that of one
    (0xFF00, 0x5400, "power section"),
    (0xFF00, 0x6100, "internal software"),
    (0xFF00, 0x6200, "user software"),
    (0xFF00, 0x6300, "data set"),
    (0xFF00, 0x7100, "power unit"),
    (0xFF00, 0x7300, "sensor"),
    (0xFF00, 0x8100, "communication"),
    (0xFF00, 0x8200, "protocol"),
    (0xFF00, 0x9000, "external error"),
    (0xFF00, 0xFF00, "device specific"),
    (0xF000, 0x1000, "generic error"),
    (0xF000, 0x2000, "current"),
    (0xF000, 0x3000, "voltage"),
    (0xF000, 0x4000, "temperature"),
    (0xF000, 0x5000, "hardware of the device"),
    (0xF000, 0x6000, "software of the device"),
    (0xF000, 0x7000, "additional modules"),
    (0xF000, 0x8000, "monitoring"),
    (0xF000, 0xF000, "additional functions"),
)
_REGISTER = ("generic", "current", "voltage", "temperature", "communication", "profile", "reserved", "manufacturer's")


def emergency_words(data: bytes) -> str:
    """An emergency message of 8 bytes: code, words, error register, and the maker's own five bytes where they say
    anything.
    """
    code, register, own = EMCY.unpack(data)
    if code == 0:
        return "emergency 0000h: no error any more"
    words = _CODES.get(code) or next((text for mask, value, text in _CLASSES if code & mask == value), "unknown code")
    bits = ", ".join(name for bit, name in enumerate(_REGISTER) if register >> bit & 1) or "none"
    maker = f"; maker's bytes {own.hex(' ')}" if any(own) else ""
    return f"emergency {code:04X}h: {words}; error register {bits}{maker}"
