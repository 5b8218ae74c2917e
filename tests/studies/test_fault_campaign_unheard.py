"""What the campaign asks of drives that do not hear the host, or no reset: what they do by themselves, and no more."""

import pytest

from hil.rig.file import load_rig
from hil.studies.fault_campaign.catalogue import TRIALS
from hil.studies.fault_campaign.checkpoints import READY, CampaignRun, bring_to, checkpoints
from hil.studies.fault_campaign.layout_capabilities import Capability, fixed_capabilities
from hil.studies.fault_campaign.matrix import Cell, displaced, run_cell
from hil.studies.fault_campaign.trial import Trial
from sim_plant.drives.servo import ServoDrive
from tests.support.paths import RIGS

WHOLE = Capability.STATE | Capability.CHECKSUM | Capability.SEQUENCE


def trial_named(name: str) -> Trial:
    return next(trial for trial in TRIALS if trial.name == name)


def test_only_drives_without_a_checksum_need_not_let_go_while_every_command_is_damaged() -> None:
    trial = trial_named("damaged commands")
    assert not trial.over(WHOLE).unheld
    without = trial.over(WHOLE & ~Capability.CHECKSUM)
    assert (without.unheld, without.deaf) == (True, False)
    assert [other.name for other in TRIALS if other.unheld] == ["damaged commands"]


def cell_of_silence() -> Cell:
    """A rig that becomes READY just before nothing is heard any more; its drives still apply the last torque."""
    rig = displaced(load_rig(RIGS / "robstride.toml"))
    point = next(point for point in checkpoints(rig) if point.name == "STOPPING from 0/8 turn")
    return run_cell(trial_named("all encoders silent"), point, 0, bring_to(rig, RIGS, point))


@pytest.mark.long
def test_drives_that_hear_nothing_are_at_zero_by_their_own_watchdog() -> None:
    cell = cell_of_silence()
    assert (cell.passed, cell.fault, cell.why) == (True, "encoder_dead", "")


@pytest.mark.long
@pytest.mark.replaces_methods
def test_drives_without_a_watchdog_fail_the_same_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ServoDrive, "trip", lambda self, now_ns: setattr(self, "deadline_ns", now_ns + 10**9))
    cell = cell_of_silence()
    assert not cell.passed
    assert "the drives" in cell.why


RESETS = "started again, and the operator resets"


def cell_of_reset(*overrides: str) -> Cell:
    """The operator resets drives that have tripped."""
    run = bring_to(displaced(load_rig(RIGS / "paper-dbc.toml", overrides)), RIGS, READY)
    return run_cell(trial_named(RESETS).over(fixed_capabilities(run.cycle.protocol)), READY, 0, run)


@pytest.mark.long
def test_drives_that_hear_no_reset_keep_what_they_latched_and_the_cell_says_why() -> None:
    with_reset, without = cell_of_reset(), cell_of_reset("bus.dbc.reset=[]")
    assert [(cell.why, cell.lacking) for cell in (with_reset, without)] == [("", ""), ("", "no reset")]


@pytest.mark.long
@pytest.mark.replaces_methods
def test_drives_that_are_reset_although_they_hear_none_fail_the_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = CampaignRun.restart

    def denying(run: CampaignRun) -> None:
        honest(run)
        run.cycle.protocol.resets = False

    monkeypatch.setattr(CampaignRun, "restart", denying)
    assert cell_of_reset().why == "ended READY, expected CONNECTED"
