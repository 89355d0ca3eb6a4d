"""The pages say what the program does."""

import re
from functools import cache
from pathlib import Path

import pytest

from flows.cli import app
from residual.model.nominal import DEFAULT_DECLARED


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


MEASURED = ("benchmarks", "public_logs")  # written by benchmarks/page.py

ROOT = Path(__file__).parents[1]
GENERATED = {"commands.md", "glossary.md", "python.md"}  # when the site is built
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_links_only_to_pages_that_exist(page):
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    pages = [link for link in links if not link.endswith(".png")]  # made by a run
    pages = [link for link in pages if Path(link).name not in GENERATED]
    assert [link for link in pages if not (page.parent / link).exists()] == []


def test_the_pages_stay_at_half_of_their_words():
    """At most 26 420 words in docs with the measured pages, 700 in the README."""
    words = {page: len(page.read_text(encoding="utf-8").split()) for page in PAGES}
    measured = sum(n for p, n in words.items() if p.stem in MEASURED)
    assert words[ROOT / "README.md"] <= 700
    assert sum(words.values()) - measured <= 23_020
    docs = [n for page, n in words.items() if ROOT / "docs" in page.parents]
    assert sum(docs) <= 26_420


def test_the_default_list_of_declared_effects_is_the_one_in_the_text():
    assert f"`{','.join(DEFAULT_DECLARED)}`" in _text("docs/logs.md")


def test_every_option_that_a_page_shows_exists():
    shown = [
        (command, option)
        for page in PAGES
        for command, rest in re.findall(
            r"modelgap ((?:(?:model|project|sensors|sim|store) )?[\w-]+)([^`\n#]*)",
            page.read_text(encoding="utf-8"),
        )
        for option in re.findall(r"--([\w-]+)", rest)
    ]
    assert shown
    for command, option in shown:
        found = app
        for word in command.split():
            found = found[word]
        known = found.assemble_argument_collection()
        names = {name for argument in known for name in argument.names}
        assert f"--{option}" in names, (command, option)


FOLDERS = ("residual", "flows", "sim", "warehouse", "benchmarks", "tests")


@cache
def _code() -> set[str]:
    paths = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*"))
    there = {f"/{path.relative_to(ROOT).as_posix()}" for path in paths}
    # The door, and the example of an effect.
    return there | {"/modelgap.py", "/creaking.py", "/residual/effects/creaking.py"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_names_only_files_and_folders_of_code_that_are_there(page):
    text = page.read_text(encoding="utf-8")
    if page.name == "CHANGELOG.md":  # tells of what was, too
        text = text.split("\n## ")[0]
    files = re.findall(r"`((?:\w+/)*\w+\.py)`", text)
    roots = "|".join(FOLDERS)
    files += re.findall(rf"`((?:{roots})/[\w/]*\w)/?`", text)
    assert [f for f in files if not any(p.endswith(f"/{f}") for p in _code())] == []
