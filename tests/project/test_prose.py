"""The prose linter: what it finds, what it spares, and that no page has anything for it."""

import pytest

from tests.project.prose import (
    MOST_WORDS,
    code,
    docstrings,
    findings,
    messages,
    pages,
    paragraphs,
    sentences_of,
)


def wrong(text: str) -> list[str]:
    return [finding.wrong for finding in findings(("page.md", line, block) for line, block in paragraphs(text))]


def words(count: int) -> str:
    return "Word " + "word " * (count - 2) + "word."


def test_a_sentence_may_be_as_long_as_it_may_be_and_no_longer() -> None:
    assert wrong(words(MOST_WORDS)) == []
    assert wrong(words(MOST_WORDS + 1)) == [f"{MOST_WORDS + 1} words, at most {MOST_WORDS}"]
    assert wrong(f"{words(20)} {words(20)}") == []
    assert len(wrong(words(20).replace(".", "; ") + words(20))) == 1


@pytest.mark.parametrize("text", ["Whoever reads it.", "A law of yours.", "As before, but for Z.", "Simply run it."])
def test_a_phrase_that_was_given_up_is_told_with_what_to_say(text: str) -> None:
    assert len(wrong(text)) == 1
    assert wrong(text)[0].startswith("say ")


def test_code_tables_and_headings_are_no_prose() -> None:
    for text in (
        f"# {words(50)}",
        f"| {words(50)} |",
        f"    {words(50)}",
        f"```sh\n{words(50)}\n```",
        f"`{words(50)}` is one word.",
    ):
        assert wrong(text) == [], text


def test_items_and_paragraphs_are_apart_and_lines_of_one_are_not() -> None:
    half = words(20).rstrip(".")
    assert [text.split() for _, text in paragraphs(f"- {half}\n- {half}\n\n{half}\n")] == [half.split()] * 3
    assert len(wrong(f"- {half}\n  {half}\n")) == 1


def test_a_sentence_ends_before_the_next_argument_of_a_docstring() -> None:
    assert sentences_of("index: of the axis. low, high: in m.") == ["index: of the axis.", "low, high: in m."]


def test_docstrings_of_public_names_are_read_and_of_no_others() -> None:
    public = '"""Module."""\nclass A:\n    """Of A."""\n    def f(self):\n        """Of f."""\n'
    found = docstrings(f'{public}def _g():\n    """Of g."""\n')
    assert sorted(text for _, text in found) == ["Module.", "Of A.", "Of f."]


def test_nothing_is_wrong_with_a_page_or_a_message() -> None:
    assert [str(finding) for finding in (*findings(pages()), *findings(messages()), *findings(code()))] == []
