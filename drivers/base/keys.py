"""Keys of the rig file: default, meaning and unit of each in one place, as a pydantic field.

docs/rig-file.md, the JSON schema for editors and `hil explain` are made from these declarations.
"""

from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, model_validator

STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
REQUIRED = ...


def key(default: Any, description: str, unit: str = "", *, derived: str = "", **bounds: Any) -> Any:
    """A key of the rig file, as a pydantic field.

    default: its value where the file says nothing, REQUIRED where the file has to say it. unit: SI, "1" for a number
    without one. derived: where the value comes from if not from the file, in words. bounds: pydantic's ge, gt, le, lt.
    """
    extra: dict[str, Any] = {name: text for name, text in (("unit", unit), ("derived", derived)) if text}
    return Field(default, description=description, json_schema_extra=extra, **bounds)


class Table(BaseModel):
    """A table of the rig file: no keys but its own, and no value of another type than its key's."""

    model_config = STRICT

    @model_validator(mode="before")
    @classmethod
    def _whole_numbers(cls, table: Any) -> Any:
        """JSON, and with it the schema of rig files, knows one kind of number: 3.0 is 3, and true is not 1."""
        if not isinstance(table, dict):
            return table
        fields = cls.model_fields
        whole = {name for name, field in fields.items() if int in _members(field.annotation)}
        named = {name for name, field in fields.items() if get_origin(field.annotation) is Literal}
        shown = {name: str(table[name]).lower() for name in named & table.keys() if isinstance(table[name], bool)}
        return {name: _as_whole(value) if name in whole else value for name, value in (table | shown).items()}


def _members(annotation: Any) -> set[Any]:
    """The types that a type is made of, itself among them; whole numbers are left out where others are allowed."""
    parts = {member for part in get_args(annotation) for member in _members(part)}
    found = parts | {annotation} if isinstance(annotation, type) else parts
    return found - {int} if float in found else found


def _as_whole(value: Any) -> Any:
    if isinstance(value, list):
        return [_as_whole(item) for item in value]
    return int(value) if type(value) is float and value.is_integer() else value
