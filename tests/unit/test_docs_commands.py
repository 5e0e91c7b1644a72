"""No command of the README and the docs is shown without a test that looks at it.

`test_docs` runs or parses what stands in console blocks. Here: nothing of ours stands elsewhere unseen.
"""

import re
import shlex

import pytest
from typer.exceptions import TyperException

from tests.unit.test_docs import (
    CODE,
    FENCE,
    LINK,
    PAGES,
    PROGRAMS,
    ROOT,
    TEXTS,
    check_without_running,
    commands,
    is_run,
    prose,
)

OTHERS_TARGETS = {"px4_sitl", "px4_sitl_default"}  # of PX4's own Makefile
ENDS = {"--help", "--version", "-h"}


def is_ours(line: str) -> bool:
    """Whether a line begins with a program of ours, a make target of ours, or a module run by Python."""
    words = line.split()
    if words[:1] == ["make"]:
        return words[1:2] != [] and words[1] not in OTHERS_TARGETS
    return len(words) > 1 and (words[0] in PROGRAMS or words[:2] == ["python", "-m"])


@pytest.mark.parametrize("name", PAGES)
def test_a_block_with_a_command_of_ours_is_a_console_block(name: str) -> None:
    fences = re.findall(r"^\s*```", TEXTS[name], re.MULTILINE)
    assert len(fences) == 2 * len(FENCE.findall(TEXTS[name]))
    others = [body for kind, body in FENCE.findall(TEXTS[name]) if kind != "console"]
    # "companion  link.connection: ..." names a program in a table of settings
    lines = [line for body in others for line in body.splitlines() if is_ours(line)]
    assert [line for line in lines if not re.match(r"companion\s+link\.", line)] == []


def shown_in_prose() -> list[tuple[str, str]]:
    """Page and command, of all that are more than a name: with an option, or a target of make."""
    return sorted(
        {
            (name, word)
            for name, text in TEXTS.items()
            for word in CODE.findall(prose(text))
            if is_ours(word) and not word.endswith("...") and (" -" in word or word.startswith("make "))
        }
    )


@pytest.mark.parametrize(("name", "command"), shown_in_prose())
def test_a_command_in_the_prose_is_one_that_would_start(name: str, command: str) -> None:
    words = shlex.split(command)
    if not ENDS & set(words):
        check_without_running(words)


def test_the_checks_would_notice() -> None:
    for wrong in ("companion --wings", "companion-sitl hand-held --settings x.yaml", "companion pad --tilt"):
        with pytest.raises(TyperException):
            check_without_running(shlex.split(wrong))
    for wrong in (
        "make bench-nothing",
        "python -m docs.nothing",
        "python -m benchmarks nothing",
        "pip install -r no.txt",
        "rm -rf .",
    ):
        with pytest.raises((AssertionError, ModuleNotFoundError)):
            check_without_running(shlex.split(wrong))


def test_every_command_of_the_tour_runs() -> None:
    shown = commands(TEXTS["tour.md"])
    assert len(shown) > 5
    assert all(is_run(words, "tour.md") for words in shown)


def test_the_readme_leads_to_every_page_but_the_single_decisions() -> None:
    linked = {link.partition("#")[0] for link in LINK.findall(prose(TEXTS["README.md"]))}
    pages = {str(page.relative_to(ROOT)) for page in (ROOT / "docs").rglob("*.md")}
    decisions = {page for page in pages if re.fullmatch(r"docs/decisions/\d{4}-.*", page)}
    assert pages - decisions - {"docs/index.md"} <= linked


def test_the_list_of_decisions_leads_to_each() -> None:
    folder = ROOT / "docs" / "decisions"
    linked = set(LINK.findall(TEXTS["decisions.md"]))
    assert {page.name for page in folder.glob("*.md")} - {"decisions.md"} <= linked


MOST_WORDS_OF_THE_README = 1200


def test_the_readme_is_short() -> None:
    assert len(TEXTS["README.md"].split()) <= MOST_WORDS_OF_THE_README
