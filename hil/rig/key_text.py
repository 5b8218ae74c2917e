"""What `hil explain` prints of a key or a table. Loads neither the schema nor a command-line library."""

from hil.rig.reference import Key, Table, explain, tables


def key_text(path: str) -> str:
    """Of a key, of the table of that path, or of both; of "": every table, a line each. Raises UnknownKeyError."""
    if not path:
        return "\n".join(f"{table.path or 'the file itself':20}  {_summary(table)}" for table in tables())
    key, table = explain(path)
    return "\n".join([*([_described(key)] if key else []), *([_listed(table)] if table else [])])


def _summary(table: Table) -> str:
    return table.description.partition("]: ")[2] or table.description


def _described(key: Key) -> str:
    rows = {"type": key.kind, "unit": key.unit, "allowed": key.allowed, "default": key.default}
    return "\n".join([f"{key.path}: {key.description}", *(f"  {name:8} {text}" for name, text in rows.items() if text)])


def _listed(table: Table) -> str:
    names = [key.path.rpartition(".")[2] for key in table.keys]
    width = max(map(len, names))
    rows = [f"  {name:{width}}  {key.description}" for name, key in zip(names, table.keys, strict=True)]
    return "\n".join([table.description, *rows])
