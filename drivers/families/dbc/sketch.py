"""What `hil new` writes for drives of a DBC file: a file such as a supplier might have, and its binding."""

from collections.abc import Sequence

from drivers.families import Sketched, SketchedAxis


def sketch(name: str, axes: Sequence[SketchedAxis], watchdog_s: float) -> Sketched:
    """The file and the table that binds its signals."""
    return Sketched(_binding_text(axes), file=dbc_text(axes), ending=".dbc")


def _binding_text(axes: Sequence[SketchedAxis]) -> str:
    """[bus.dbc] for the DBC file of `dbc_text`."""

    def table(key: str, message: str, signal: str, scales: list[float] | None = None) -> str:
        rows = [
            f'    {{ message = "{message}_{axis.name}", signal = "{signal}"'
            + (f", scale = {scales[number]!r}" if scales else "")
            + " },"
            for number, axis in enumerate(axes)
        ]
        return "\n".join([f"{key} = [", *rows, "]"])

    checksums = [f'    {{ message = "{m}_{axis.name}", signal = "Checksum" }},' for m in _MESSAGES for axis in axes]
    return "\n".join(
        [
            "# Which signal of the DBC file is what, one per axis; put your drives' names here.",
            "# scale: encoder counts per unit of a position, N (N m) per unit of a torque.",
            "[bus.dbc]",
            table("position", "Feedback", "Position", [1.0] * len(axes)),
            table("torque", "Demand", "Torque", [float(f"{axis.force / 100.0:.6g}") for axis in axes]),
            table("status", "Feedback", "State"),
            table("enable", "Demand", "Enable"),
            table("reset", "Demand", "Reset"),
            table("command_counter", "Demand", "Counter"),
            table("feedback_counter", "Feedback", "Counter"),
            "\n".join(["checksum = [", *checksums, "]"]),
            "",
        ]
    )


_MESSAGES = ("Demand", "Feedback")


def dbc_text(axes: Sequence[SketchedAxis]) -> str:
    """A DBC file of drives such as a supplier might describe: a command and an answer per axis, torque in per cent of
    the rated force, position in counts.
    """
    lines = [
        'VERSION ""',
        "",
        "NS_ :",
        "",
        "BS_:",
        "",
        f"BU_: Controller {' '.join(f'Drive_{a.name}' for a in axes)}",
        "",
    ]
    for number, axis in enumerate(axes):
        lines += [
            f"BO_ {0x210 + number} Demand_{axis.name}: 6 Controller",
            f' SG_ Torque : 7|16@0- (0.01,0) [-327.68|327.67] "%" Drive_{axis.name}',
            f' SG_ Enable : 23|1@0+ (1,0) [0|1] "" Drive_{axis.name}',
            f' SG_ Reset : 22|1@0+ (1,0) [0|1] "" Drive_{axis.name}',
            f' SG_ Counter : 19|4@0+ (1,0) [0|15] "" Drive_{axis.name}',
            f' SG_ Checksum : 47|8@0+ (1,0) [0|255] "" Drive_{axis.name}',
            "",
            f"BO_ {0x310 + number} Feedback_{axis.name}: 8 Drive_{axis.name}",
            ' SG_ Position : 7|32@0- (1,0) [-2147483648|2147483647] "counts" Controller',
            ' SG_ Counter : 35|4@0+ (1,0) [0|15] "" Controller',
            ' SG_ State : 46|7@0+ (1,0) [0|127] "" Controller',
            ' SG_ Checksum : 63|8@0+ (1,0) [0|255] "" Controller',
            "",
        ]
    return "\n".join(lines)
