"""What the README says exists, exists, and is what it says."""

import re

from hil.cli.app import COMMANDS
from tests.support.paths import ROOT

README = (ROOT / "README.md").read_text()


def test_the_subscriber_shown_is_the_one_that_is_tested() -> None:
    assert (ROOT / "deploy" / "examples" / "subscribe.py").read_text() in README


def test_every_link_leads_somewhere() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets
    assert [target for target in targets if not (ROOT / target).exists()] == []


def test_every_command_shown_exists() -> None:
    assert set(re.findall(r"\bhil ([a-z]+)\b(?= |`)", README)) <= set(COMMANDS)
    assert set(re.findall(r"^make ([a-z]+)", README, re.M)) == {"run", "test"}


def test_every_rig_and_scenario_shown_exists() -> None:
    shown = re.findall(r"deploy/(?:rigs|scenarios)/[a-z-]+\.toml", README)
    assert [path for path in shown if not (ROOT / path).exists()] == []
