"""Of every attack it is said what the code before made of it."""

from tests.attacks import on_commands, on_files, on_goals, on_processes, on_zenoh
from tests.attacks.before import BEFORE, before
from tests.attacks.registry import ATTACKS

MODULES = (on_commands, on_files, on_goals, on_processes, on_zenoh)


def test_every_attack_has_its_line_and_every_line_its_attack() -> None:
    assert len({module.__name__ for module in MODULES}) == len(MODULES)
    listed = [listed.name for listed in ATTACKS]
    assert len(set(listed)) == len(listed) >= 30
    assert {before(name).attack for name in listed} == {entry.attack for entry in BEFORE}
