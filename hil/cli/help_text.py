"""What `--help` prints: plain text, types in words, one spelling of an option."""

from functools import partial
from typing import Any

from typer.core import TyperGroup

FORMER_SPELLINGS = {"--output": "--out", "--jobs": "--workers"}  # of 0.1.0; taken for one more version
PRINT_JSON = {"doctor", "events"}  # commands whose --json takes no file
WORDS = {"Path": "PATH", "str": "TEXT", "int": "NUMBER", "float": "NUMBER", "bool": ""}


class Overview(TyperGroup):
    """The list of all commands, by groups."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """See click. Without a word, the list is shown."""
        if not args and not ctx.resilient_parsing:
            print(ctx.get_help())
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """See click."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            heading = getattr(command, "rich_help_panel", None) or "Commands"
            groups.setdefault(heading, []).append((name, command.help or ""))
        widest = max(map(len, self.commands))
        for heading, rows in groups.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(widest), text) for name, text in rows])


def in_words(command: Any) -> Any:
    """A click command, or a group with all below it, whose help names types in words."""
    for below in getattr(command, "commands", {}).values():
        in_words(below)
    for parameter in command.params:
        if parameter.param_type_name == "option" and parameter.metavar is None:
            parameter.metavar = _word(parameter)
        if parameter.param_type_name == "argument":
            parameter.metavar = parameter.metavar or parameter.name.upper()
            parameter._usage_display_name = partial(_in_usage, parameter)
            if not parameter.type_descriptor.is_choice:
                parameter.display_type_rich = lambda ctx: None  # its name says what it is
    return command


def _in_usage(parameter: Any) -> str:
    """RIG, [RIG] or RIG...; typer's own forms are "{RIG}" and "[[RIG]]"."""
    name: str = parameter.metavar
    if not parameter.required and not name.startswith("["):
        name = f"[{name}]"
    return f"{name}..." if parameter.nargs != 1 and not name.endswith("...") else name


def _word(parameter: Any) -> str | None:
    """What an option takes, such as "NUMBER from 1 to 20"; None leaves the list of a choice as it is."""
    if parameter.type_descriptor.is_choice:
        return None
    word = WORDS[parameter.bare_type().removeprefix("list[").removesuffix("]")]
    least, greatest = parameter.min, parameter.max
    parameter._get_number_range_help_str = lambda: None  # typer's own form is "[1<=x<=20]"
    if least is not None and greatest is not None:
        return f"{word} from {least:g} to {greatest:g}"
    if least is not None:
        return f"{word} from {least:g}"
    return word


def present_spelling(words: list[str]) -> tuple[list[str], list[str]]:
    """(the command line as typer takes it, a line for each option that was written as 0.1.0 had it).

    `--json` without a file means standard output, in every command.
    """
    told: list[str] = []
    now: list[str] = []
    for number, word in enumerate(words):
        if word == "--":
            return [*now, *words[number:]], told
        option, equals, value = word.partition("=")
        if option in FORMER_SPELLINGS:
            told.append(f"{option} is now {FORMER_SPELLINGS[option]}; the old spelling goes in the next version")
            option = FORMER_SPELLINGS[option]
        now.append(f"{option}{equals}{value}")
        followed = number + 1 < len(words) and not words[number + 1].startswith("--")
        if word == "--json" and not followed and words[0] not in PRINT_JSON:
            now.append("-")
    return now, told
