"""What is to be done with one CiA 402 drive before it runs, step by step, or why it cannot be used."""

from dataclasses import dataclass, field
from typing import NamedTuple

from drivers.families.cia402.sdo import Step

FULL_SCALE = 32767  # of 6071h


class Reason(NamedTuple):
    """Why a drive cannot be used: the object that decides it, and what is wrong with it. remedy: what can be stated
    about the drive so that it can; empty where nothing helps.
    """

    object: str
    text: str
    remedy: str = ""


class Planned(NamedTuple):
    """One step of a plan. need: required, optional or extra. skipped: why it is not made, or empty."""

    step: Step
    need: str
    why: str
    skipped: str = ""


class Axis(NamedTuple):
    """The place of a drive on the rig. number: 0-based, of so many in total. first_node: of axis 0, by whose number the
    shared RPDOs are called. rated_force: N or N m, None where it is not known. period_ns: of SYNC, 0 where it is not
    known. master_ms: silence of the host that the drive bears.
    """

    number: int
    total: int
    node_id: int
    first_node: int
    rated_force: float | None
    period_ns: int
    master_ms: int


@dataclass
class DrivePlan:
    """What is to be done with one drive. unit: 6076h in mN m (mN), None where it is read from the drive at the start.

    most: thousandths that its file lets 6071h be, either way. limit: the most it may be told. emcy_id: identifier of
    its emergency messages, 0 where it sends none. watched: its answers show its mode. inputs: its TPDO 2 tells its
    digital inputs. probe: its TPDO 3 tells its touch probe. no_probe: why its touch probe cannot be asked, or empty.
    no_homing: why it cannot home by itself. proofs: reads of every place that the plan writes and the file lets be
    read, and of 6061h where the file has it; by index.
    """

    name: str
    offers: list[str] = field(default_factory=list)
    shared: bool = True
    counter: bool = True
    unit: int | None = None
    most: int = FULL_SCALE
    limit: int = FULL_SCALE
    emcy_id: int = 0
    planned: list[Planned] = field(default_factory=list)
    watched: bool = False
    inputs: bool = False
    probe: bool = False
    no_probe: str = ""
    no_homing: str = ""
    proofs: list[Step] = field(default_factory=list)
    reasons: list[Reason] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def answer_length(self) -> int:
        """Bytes of its answers: position, statusword, and its mode."""
        return 7 if self.watched else 6

    @property
    def usable(self) -> bool:
        """Nothing that the files tell stands against it."""
        return not self.reasons

    @property
    def mode(self) -> str:
        """CST, or empty for a drive that is refused."""
        return "CST" if self.usable else ""

    @property
    def steps(self) -> list[Step]:
        """What the master makes, in this order."""
        return [*(planned.step for planned in self.planned if not planned.skipped), *self.proofs]
