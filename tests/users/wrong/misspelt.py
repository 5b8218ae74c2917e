"""What an editor must find: each line below with a mistake names the rule that tells it."""

from collections.abc import Sequence

import hil


class Late(hil.Law):
    """A law that reads what is not there."""

    def reset(self, position: float, force: float) -> None:
        """Nothing to forget."""

    def force(self, inputs: hil.LawInputs) -> float:
        return float(inputs.positon_estimate)  # mypy: attr-defined  pyright: reportAttributeAccessIssue


class Unfinished(hil.Task):
    """A task without samples."""

    def __init__(self, axes: Sequence[str]) -> None:
        super().__init__(axes)


def main() -> None:
    """One mistake a line."""
    hil.Recording("run.mcap").sumary()  # mypy: attr-defined  pyright: reportAttributeAccessIssue
    hil.load_rig("paper", override=["law.name=pid"])  # mypy: call-arg  pyright: reportCallIssue
    hil.simulate("paper", secconds=2.0)  # mypy: call-arg  pyright: reportCallIssue
    run = hil.simulate("paper")
    hil.simulate("paper", seconds="2")  # mypy: arg-type  pyright: reportArgumentType
    print(run.trace_sha)  # mypy: attr-defined  pyright: reportAttributeAccessIssue
    print(run.columns["positon"])  # mypy: index  pyright: reportArgumentType
    summary = run.summary()
    print(summary["final"])  # mypy: typeddict-item  pyright: reportGeneralTypeIssues
    print(summary["axes"]["x"]["max_eror"])  # mypy: typeddict-item  pyright: reportGeneralTypeIssues
    print(hil.Gain(1.0, unit="N", leest=0.0))  # mypy: call-arg  pyright: reportCallIssue
    Unfinished(["x"])  # mypy: abstract  pyright: reportAbstractUsage
    hil.connect("paper").comand("stop")  # mypy: attr-defined  pyright: reportAttributeAccessIssue
