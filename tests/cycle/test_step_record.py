"""A tick's record says what its cycle knows: the newest command, the drives, the counters, from the first tick on."""

from hil.cycle.state_machine import TORQUE_STATES, State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS


def test_from_the_first_tick_on_a_record_says_what_the_cycle_knows() -> None:
    def operator(run: LockstepRun, index: int) -> list[CommandKind]:
        return [said[index]] if index in said else []

    said = {5: CommandKind.HOME, 60: CommandKind.ACTIVATE, 90: CommandKind.STOP}

    run = LockstepRun(load_rig(RIGS / "paper.toml"), RIGS, operator=operator)
    refused, states, applied = 0, set(), [[0.0, 0.0], [0.0, 0.0]]
    for index in range(120):
        record, cycle = run.tick().record, run.cycle
        n = len(cycle.inbox.samples)
        status = [0 if sample is None else int(sample.status) for sample in cycle.inbox.samples]
        assert record["drive_status"].tolist() == status + [0] * (4 - n)
        assert record["age_ticks"].tolist()[:n] == cycle.inbox.age
        assert int(record["sequence"]) == max(cycle.sent_sequence, 0)
        assert int(record["state"]) == int(cycle.state)
        commands = record["commands"][: int(record["n_commands"])]
        refused += int((commands["accepted"] == 0).sum())
        assert int(record["commands_refused"]) == refused
        assert int(record["task_ns"]) == cycle.setpoints.task_ns
        assert [(x.force_before, x.force_last) for x in cycle.inputs] == list(zip(*applied[-2:], strict=True))
        applied.append(list(cycle.gate.force))
        if cycle.state not in TORQUE_STATES:
            assert not record["force_requested"].any()
        states.add(cycle.state)
        if index == 0:
            assert (int(record["sequence"]), status, int(record["n_received"])) == (0, [0] * n, 0)
    assert refused == 1  # HOME, before the axes are ready
    assert {State.ACTIVE, State.STOPPING} < states
    assert cycle.state is State.READY
    assert len({tuple(force) for force in applied}) > 30
    assert int(record["sequence"]) > 100
    assert all(record["drive_status"].tolist()[:n])
