"""All that a user can name has its place in the pages, and nothing else is named."""

import json
import re

import pytest

import modelgap as mg
from flows.cli import app
from residual.effects import load_effects
from scripts.docs_site import pages
from tests.checkout import ROOT

PAGES = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
TEXT = {page: page.read_text(encoding="utf-8") for page in PAGES}
ALL = "\n".join(TEXT.values())
COMMANDS = [name for group in app.GROUPS.values() for name in group["commands"]]
GROUPS = {
    group["word"]: {app._SHORTER.get(name, name) for name in group["commands"]}
    for group in app.GROUPS.values()
    if "word" in group
}
# In a span or block of code, at its start or after a prompt: no word of a sentence.
_CALLED = re.compile(r"(?:`|^\$ |^|&& |; )modelgap ([a-z][\w-]*)(?: ([a-z][\w-]*))?", re.M)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_has_its_place_beside_the_generated_reference(name):
    short = app._SHORTER.get(name, name)
    of = next((word for word, names in GROUPS.items() if short in names), "")
    called = rf"modelgap ({name}|{of} {short})\b"
    assert re.search(called, ALL), f"no page shows modelgap {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_shows_no_command_that_is_not_there(page):
    code = "\n".join(re.findall(r"```.*?```|`[^`\n]+`", TEXT[page], re.S))
    for command, inner in _CALLED.findall(code):
        assert command in {*COMMANDS, *GROUPS}
        assert not inner or inner in GROUPS.get(command, {inner}), (command, inner)


def test_the_reference_explains_every_option_of_every_command():
    sections = re.split(r"^### ", pages.commands_page(), flags=re.M)[1:]
    assert [section.split("\n")[0] for section in sections] == COMMANDS
    for name, section in zip(COMMANDS, sections, strict=True):
        options = pages.option_words(name)
        assert len(re.findall(r"^\| `", section, re.M)) == len(options), name
        assert [word for word, told in options.items() if len(told) < 8] == [], name


def test_every_public_name_stands_on_the_page_of_the_door():
    page = TEXT[ROOT / "docs" / "api.md"]
    assert [name for name in mg.__all__ if not re.search(rf"\b{name}\b", page)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_uses_no_public_name_that_is_not_there(page):
    assert set(re.findall(r"\bmg\.([A-Za-z]\w+)", TEXT[page])) <= set(mg.__all__)


def _keys(value) -> set[str]:
    if isinstance(value, list):
        return set().union(*map(_keys, value), set())
    if isinstance(value, dict):
        return set(value) | set().union(*map(_keys, value.values()), set())
    return set()


@pytest.mark.parametrize("name", ["effects", "none", "unknown"])
def test_every_key_of_a_real_verdict_is_explained(name):
    path = ROOT / "tests" / "frozen" / f"{name}.json"
    verdict = json.loads(path.read_text(encoding="utf-8"))
    page = TEXT[ROOT / "docs" / "verdict.md"] + TEXT[ROOT / "docs" / "check.md"]
    explained = set(re.findall(r"`([\w.]+)`", page))
    explained |= {part for name in explained for part in name.split(".")}
    params = {key for effect in load_effects().values() for key in effect.parameters}
    motion = set(re.findall(r"`(\w+)`", TEXT[ROOT / "docs" / "experiments.md"]))
    assert _keys(verdict) - explained - params - motion == set()
