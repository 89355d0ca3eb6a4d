"""The pages say what the program does, and name all that a user can name."""

import ast
import builtins
import json
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import modelgap as mg
from flows import cli as commands
from flows.cli import app
from residual.effects import load_effects
from residual.model.nominal import DEFAULT_DECLARED
from scripts.docs_site import pages
from tests.checkout import ROOMS, ROOT, nodes, sources


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


MEASURED = ("benchmarks", "public_logs")  # written by benchmarks/page.py

GENERATED = {"commands.md", "glossary.md", "python.md"}  # when the site is built
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_links_only_to_pages_that_exist(page):
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    pages = [link for link in links if not link.endswith(".png")]  # made by a run
    pages = [link for link in pages if Path(link).name not in GENERATED]
    assert [link for link in pages if not (page.parent / link).exists()] == []


def test_the_pages_stay_at_half_of_their_words():
    """At most 26 850 words in docs with the measured pages, 700 in the README."""
    words = {page: len(page.read_text(encoding="utf-8").split()) for page in PAGES}
    measured = sum(n for p, n in words.items() if p.stem in MEASURED)
    assert words[ROOT / "README.md"] <= 700
    assert sum(words.values()) - measured <= 23_020
    docs = [n for page, n in words.items() if ROOT / "docs" in page.parents]
    assert sum(docs) <= 26_850


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


# All that a user can name has its place in the pages, and nothing else is named.


SHOWN = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
TEXT = {page: page.read_text(encoding="utf-8") for page in SHOWN}
ALL = "\n".join(TEXT.values())
COMMANDS = [name for group in commands.GROUPS.values() for name in group["commands"]]
GROUPS = {
    group["word"]: {commands._SHORTER.get(name, name) for name in group["commands"]}
    for group in commands.GROUPS.values()
    if "word" in group
}
# In a span or block of code, at its start or after a prompt: no word of a sentence.
_CALLED = re.compile(r"(?:`|^\$ |^|&& |; )modelgap ([a-z][\w-]*)(?: ([a-z][\w-]*))?", re.M)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_has_its_place_beside_the_generated_reference(name):
    short = commands._SHORTER.get(name, name)
    of = next((word for word, names in GROUPS.items() if short in names), "")
    called = rf"modelgap ({name}|{of} {short})\b"
    assert re.search(called, ALL), f"no page shows modelgap {name}"


@pytest.mark.parametrize("page", SHOWN, ids=lambda page: page.stem)
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


@pytest.mark.parametrize("page", SHOWN, ids=lambda page: page.stem)
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


# What a docstring or a comment of the product refers to exists.


# Of other programs: functions of C, keys of a spec, the prefix of effects without name.
FOREIGN = re.compile(r"f(abs|min|max)|sgn|x_\.\.\.|plant\.effect\.2\.level|mg\.\w+")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


# Where a node of each kind has a name.
FIELDS = {
    **dict.fromkeys((ast.FunctionDef, ast.ClassDef, ast.alias), "name"),
    **dict.fromkeys((ast.arg, ast.keyword), "arg"),
    **{ast.Name: "id", ast.Attribute: "attr", ast.ImportFrom: "module"},
}


def _names() -> set[str]:
    """Return every word that the code of the product uses, and short strings."""
    names = set(dir(builtins))
    for path in sources(*ROOMS):
        names |= set(path.relative_to(ROOT).with_suffix("").parts)
        for node in nodes(path):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                names.add(node.value[:60])
            if (field := FIELDS.get(type(node))) and (word := getattr(node, field)):
                names.update(word.split("."))
    return names


def _prose(path: Path) -> Iterator[str]:
    for node in nodes(path):
        if isinstance(node, DOCUMENTED):
            yield ast.get_docstring(node, clean=False) or ""
    yield from re.findall(r"# .*", path.read_text("utf-8"))


def test_a_name_in_backticks_exists():
    names, broken = _names(), []
    for path in sources(*ROOMS):
        for text in _prose(path):
            plain = re.sub(r"```.*?```", "", text, flags=re.S)
            for name in re.findall(r"`([A-Za-z_][\w.]*)(?:\(\))?`", plain):
                parts = [name] if name in names else name.split(".")
                is_file = (ROOT / name).exists() or FOREIGN.fullmatch(name)
                if not is_file and not all(part in names for part in parts if part):
                    broken.append(f"{path.relative_to(ROOT)}: {name}")
    assert broken == []


def _documented(node: ast.AST) -> tuple[str, set[str]] | None:
    """Return the section that lists the names of a definition, and these names."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return "Args", {n.arg for n in ast.walk(node.args) if isinstance(n, ast.arg)}
    if not isinstance(node, ast.ClassDef):
        return None
    known = {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)}
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            known.add(item.target.id)
        known |= {item.name} if isinstance(item, ast.FunctionDef) else set()
    return "Attributes", known


def test_each_argument_and_attribute_that_is_explained_exists():
    broken = []
    for path in sources(*ROOMS):
        for node in nodes(path):
            if (own := _documented(node)) is None:
                continue
            section, known = own
            text = ast.get_docstring(node) or ""
            found = re.search(rf"^{section}:\n((?: {{4}}.*\n?|\n)+)", text, re.M)
            lines = found[1].splitlines() if found else ()
            listed = (re.match(r" {4}\*{0,2}(\w+(?:, \w+)*):", line) for line in lines)
            words = {w for match in listed if match for w in match[1].split(", ")}
            broken += [f"{path.name}: {node.name}: {w}" for w in sorted(words - known)]
    assert broken == []


# Public names keep to the glossary of CONTRIBUTING.md.


FILES = [*sources(*ROOMS), ROOT / "modelgap.py"]
GLOSSARY = " ".join((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split())
_LISTED, _, _GENERAL = GLOSSARY.partition("is exactly one of: ")[2].partition(". ")
BANNED = set(_LISTED.split(", "))
ONE_CLASS = set(re.findall(r"`(\w+)`", _GENERAL.partition(" name one class")[0]))
# What surface.json holds (options, keys, columns) keeps its name.
EXEMPT = {
    "Splits.found",  # verdict: evidence.splits.found
    "Diagnose.known",  # --known
    "Check.known",
    "Monitor.good",  # key of stored requests
}


@cache
def _public() -> list[str]:
    """Every public name of the product, once for each place."""
    names = [path.stem for path in FILES]
    for path in FILES:
        names += _members(nodes(path)[0].body, "")
    return names


def _members(body: list[ast.stmt], owner: str) -> Iterator[str]:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield f"{owner}{node.name}"
        elif isinstance(node, ast.ClassDef):
            yield node.name
            yield from _members(node.body, f"{node.name}.")
        elif owner and isinstance(node, ast.AnnAssign):
            yield f"{owner}{ast.unparse(node.target)}"


def test_no_public_name_is_a_word_of_the_list():
    assert "found" in BANNED
    found = {n for n in _public() if n.rpartition(".")[2].lower() in BANNED}
    assert found == EXEMPT, "see the glossary of CONTRIBUTING.md"


def test_a_general_name_has_one_class():
    assert "Table" in ONE_CLASS
    names = Counter(_public())
    assert {n for n in ONE_CLASS if names[n] > 1} == set(), "see the glossary"
