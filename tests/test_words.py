"""Words that pages and errors do not use: each has a plainer one."""

from __future__ import annotations

import re

import pytest
from places import ROOT

PLAINER = {
    r"\banew\b": "again, or what begins",
    r"\btells? of\b": "says that, or names",
    r"\bwho did not\b": "the agent that did not",
    r"\btake it that\b": "the sentence without it",
    r"(?:^|[.!?:] |\| |^- )Of an? `[^`]+`[^.|]*?,": "who does what, first",
    r"^(?:<{7}|>{7}) ": "the text that holds once both changes are made",
}
"""What is not written, as a pattern, and what to write in its place."""

PAGES = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "tests").rglob("sentences.txt")]
MADE = {page.name for page in PAGES if page.parent.name == "reference"} - {"index.md"}
"""Pages that are made from the code where the site is built, and else are not there."""
PAGES = [page.relative_to(ROOT).as_posix() for page in PAGES if "_build" not in page.parts and page.name not in MADE]


def found(text):
    """Return the line of each word of the list in a text, the word, and what to write in its place."""
    return sorted(
        (text.count("\n", 0, match.start()) + 1, " ".join(match[0].split()), plainer)
        for pattern, plainer in PLAINER.items()
        for match in re.finditer(pattern.replace(" ", r"\s+"), text, re.IGNORECASE | re.MULTILINE)
    )


@pytest.mark.parametrize("page", PAGES)
def test_no_page_and_no_error_uses_a_word_of_the_list(page):
    assert found((ROOT / page).read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "text",
    [
        "The file is\nwritten Anew.",
        "It tells\nof a fault.",
        "Robots tell of doors.",
        "Who did not is named.",
        "Take it that the door is open.",
        "It ends. Of a `team` that is lost, nothing is left.",
        "| Of an `agent`, its name |",
        "One.\n<<<<<<< HEAD\nTwo.",
    ],
)
def test_each_word_of_the_list_is_found_over_the_ends_of_lines_too(text):
    assert len(found(text)) == 1


def test_what_only_looks_alike_is_not_found():
    assert found("Renewed files; what it tells. The name of a `team`, and those who did.") == []
