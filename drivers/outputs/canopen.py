"""`kind = "cia401"` and `"cia404"`: digital outputs of a CANopen device beside CiA 402 drives, by its EDS.

Its RPDO 1 carries the outputs as 6200h (8 outputs a sub-index). Before it is started the host writes, and reads back:

- 1400h:02 = 255: it obeys at once. 1017h = 20 ms: its heartbeat, by which the host knows that it obeys.
- 1400h:05 = 10 ms: its patience for the frame; without that object 1016h: for the host's heartbeat.
- 6207h = 0, then 6206h = FFh of each byte: without its host, every output of it falls to 0.

6202h, the polarity, has to be 0 where the device has it. A device that lacks one of the others is refused by name, as
nobody knows what it does with a valve when its host is silent. Object numbers are those of CiA 401. For CiA 404 they
are assumed to be the same; where a device has others, its file says so, and it is refused.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from drivers.base.text_file import words_of
from drivers.eds.reader import Eds, EdsError, object_name, read_eds
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import NmtState
from drivers.families.cia402.master import HEARTBEAT_TICKS
from drivers.families.cia402.node import NodeMaster, Phase
from drivers.families.cia402.profile import DRIVE_HEARTBEAT_MS, MASTER_ID
from drivers.families.cia402.sdo import Step
from drivers.frame import FD, Frame
from drivers.outputs.config import OutputConfig
from drivers.protocols.base import LayoutError, Reject

PARAMETERS, MAPPING = 0x1400, 0x1600  # of RPDO 1
OUTPUTS, POLARITY, ERROR_MODE, ERROR_VALUE = 0x6200, 0x6202, 0x6206, 0x6207
CONSUMER, PRODUCER, EMERGENCY, DEVICE, SYNC_COUNTER = 0x1016, 0x1017, 0x1014, 0x1000, 0x1019
SILENCE_MS: Final = 10
HEARTBEAT_MS: Final = 20
_AT_ONCE: Final = 255  # transmission type
_MOST_MAPPED: Final = 64
_BOOT_TICKS: Final = 12  # the drives' master resets communication on the whole bus at its start


class CanopenOutputs:
    """An OutputWriter for the outputs of one device, by name. counted: SYNC carries a counter. Raises LayoutError
    naming the key.
    """

    def __init__(
        self, outputs: Mapping[str, OutputConfig], base_dir: Path, period_ns: int, *, counted: bool = False
    ) -> None:
        name, config = next(iter(outputs.items()))
        self._key = where = f"outputs.{name}"
        try:
            eds = read_eds(base_dir / config.file, config.node)
        except EdsError as error:
            raise LayoutError(f"{where}.file: {error}") from None
        except OSError as error:
            raise LayoutError(f"{where}.file: {base_dir / config.file}: {words_of(error)}") from None
        _check_profile(where, config, eds)
        cob = eds.value(PARAMETERS, 1)
        found = -1 if cob is None else cob & cia301.STANDARD_IDS
        if found != config.can_id:
            raise LayoutError(
                f"{where}.can_id = {config.can_id:#x}: its file has {found:#x} for RPDO 1 of node {config.node}"
            )
        blocks, self._length = _blocks(where, eds)
        self._masks = [(output.bit, _mask(name, output, blocks)) for name, output in outputs.items()]
        self.bits = sum(1 << output.bit for output in outputs.values())
        used = {(output.channel + 7) // 8 for output in outputs.values()}
        steps = _steps(where, eds, sorted(used), period_ns)
        if eds.entry(SYNC_COUNTER) is not None:
            steps.insert(0, Step(SYNC_COUNTER, 0, cia301.SYNC_COUNTER_MAX if counted else 0, size=1))
        if cob is not None and cob & cia301.PDO_INVALID:
            steps.append(Step(PARAMETERS, 1, found, size=4))
        self._can_id, node = config.can_id, config.node
        self._answers, self._beats = cia301.SDO_RESPONSE_ID + node, cia301.HEARTBEAT_ID + node
        emergency = eds.value(EMERGENCY)
        spoken = [] if emergency is None or emergency & cia301.PDO_INVALID else [emergency & cia301.STANDARD_IDS]
        self.can_ids = (self._answers, self._beats, *spoken)
        self._ticks = 0
        self.node = NodeMaster(node, steps)

    @property
    def ready(self) -> bool:
        """See OutputWriter: it has been configured, read back and started, and its heartbeat says that it runs."""
        return self.node.phase is Phase.RUNNING

    @property
    def problem(self) -> str:
        """See OutputWriter."""
        text = self.node.problem or self.node.emergency
        return f"{self._key}: {text}" if text else ""

    def frame(self, bits: int, sequence: int) -> Frame:
        """See OutputWriter: what else the RPDO carries is 0."""
        word = 0
        for bit, mask in self._masks:
            if bits >> bit & 1:
                word |= mask
        return Frame(self._can_id, word.to_bytes(self._length, "little"))

    def hear(self, frame: Frame) -> Reject:
        """See OutputWriter."""
        data, node = frame.data, self.node
        if frame.flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != (1 if frame.can_id == self._beats else 8):
            return Reject.WRONG_LENGTH
        if frame.can_id == self._answers:
            node.on_sdo(data)
        elif frame.can_id == self._beats:
            state = data[0] & 0x7F
            node.on_heartbeat(state)
            if state == NmtState.OPERATIONAL:
                node.on_pdo()  # as an answer would: it runs where it was told to
        else:
            node.on_emergency(data)
        return Reject.SERVICE

    def service(self) -> Frame | None:
        """See OutputWriter."""
        self._ticks += 1
        return self.node.service(self._ticks) if self._ticks >= _BOOT_TICKS else None


def _check_profile(where: str, config: OutputConfig, eds: Eds) -> None:
    stated, expected = (eds.value(DEVICE) or 0) & 0xFFFF, int(config.kind[3:])
    if stated != expected:
        raise LayoutError(
            f"{where}.kind = '{config.kind}': 1000h of its file says device profile {stated}, expected {expected}"
        )


def _blocks(where: str, eds: Eds) -> tuple[dict[int, int], int]:
    """The first bit in RPDO 1 of each byte of outputs, by sub-index of 6200h; and the RPDO's bytes."""
    found, first = {}, 0
    for place in range(1, min(eds.value(MAPPING) or 0, _MOST_MAPPED) + 1):
        mapped = eds.value(MAPPING, place) or 0
        index, subindex, bits = mapped >> 16, mapped >> 8 & 0xFF, mapped & 0xFF
        if index == OUTPUTS and bits == 8:
            found[subindex] = first
        first += bits
    if not 0 < first <= 64:
        raise LayoutError(f"{where}.file: RPDO 1 ({MAPPING:04X}h) has {first} bits")
    return found, (first + 7) // 8


def _mask(name: str, output: OutputConfig, blocks: dict[int, int]) -> int:
    block, bit = (output.channel + 7) // 8, (output.channel - 1) % 8
    if block not in blocks:
        raise LayoutError(
            f"outputs.{name}.channel = {output.channel}: RPDO 1 ({MAPPING:04X}h) does not carry "
            f"{object_name(OUTPUTS, block)}; give a DCF whose mapping does"
        )
    return 1 << blocks[block] + bit


def _steps(where: str, eds: Eds, blocks: Sequence[int], period_ns: int) -> list[Step]:
    """What is written, then the same read back. blocks: sub-indexes whose outputs fall without the host."""
    if eds.entry(PARAMETERS, 5) is not None:
        patience = (PARAMETERS, 5, SILENCE_MS, 2)
    else:
        silent_ms = max(DRIVE_HEARTBEAT_MS, 5 * HEARTBEAT_TICKS * period_ns // 1_000_000)
        patience = (CONSUMER, 1, MASTER_ID << 16 | silent_ms, 4)
    wanted = [(PARAMETERS, 2, _AT_ONCE, 1), (PRODUCER, 0, HEARTBEAT_MS, 2), patience]
    for block in blocks:
        wanted += [(ERROR_VALUE, block, 0, 1), (ERROR_MODE, block, 0xFF, 1)]  # else it would show its old value between
    for index, subindex, _, _ in wanted:
        if eds.entry(index, subindex) is None:
            raise LayoutError(
                f"{where}.file: no object {object_name(index, subindex)}: what its outputs do when the host is silent "
                "could not be set"
            )
    steps = [Step(index, subindex, value, size=size) for index, subindex, value, size in wanted]
    steps += [
        Step(index, subindex, value, mask=(1 << 8 * size) - 1, width=size, proof=True)
        for index, subindex, value, size in wanted
    ]
    inverted = [block for block in blocks if eds.entry(POLARITY, block) is not None]
    return steps + [Step(POLARITY, block, 0, mask=0xFF, width=1) for block in inverted]
