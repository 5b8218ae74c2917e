"""Documents written as TOML: what is read again is what was written."""

from drivers.base.toml_file import parse_toml, toml_text


def test_a_document_is_read_as_it_was_written() -> None:
    document = {
        "name": 'a "quoted" \\ näme\n',
        "axes": {"x y": {"limits": [-1e-9, 2.5, 3], "on": True, "nothing": None, "rows": [[0.0, -0.0], []]}},
        "empty": {},
        "left out": None,
    }
    axes = {"x y": {"limits": [-1e-9, 2.5, 3], "on": True, "rows": [[0.0, -0.0], []]}}
    text = toml_text(document)
    assert parse_toml(text) == {"name": document["name"], "axes": axes, "empty": {}}
    assert text.count("\n") == 3
