"""The lines of an EDS or DCF file as sections, keys and values; what is neither is read over and told."""

Sections = dict[str, dict[str, str]]


def read_sections(text: str, warnings: list[str]) -> Sections:
    """Keys and values by section, all names in lower case. warnings: takes what was read over."""
    sections: Sections = {}
    keys: dict[str, str] = {}
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if not line or line[0] in ";#":
            continue
        if line[0] == "[" and "]" in line:
            name = line[1 : line.index("]")].strip().lower()
            if name in sections:
                warnings.append(f"line {number}: section [{name}] again; its keys replace the earlier ones")
            keys = sections.setdefault(name, {})
        elif "=" in line:
            key, _, value = line.partition("=")
            keys[key.strip().lower()] = _without_comment(value)
        else:
            warnings.append(f"line {number}: neither a section nor key=value: {line[:40]!r}")
    return sections


def _without_comment(value: str) -> str:
    """A comment behind a value begins with a semicolon that stands behind a space."""
    for at, character in enumerate(value):
        if character == ";" and (at == 0 or value[at - 1].isspace()):
            return value[:at].strip()
    return value.strip()
