"""The pages say what the program does."""

import re
from pathlib import Path

import pytest

from flows.cli.app import app
from residual.effects import vocabulary
from residual.model.nominal import DEFAULT_DECLARED
from residual.robot.files import parse_toml, read_robot_toml
from scripts.docs_site import pages
from warehouse.logs.columns import load_columns
from warehouse.query.named import NAMED, TAKES

ROOT = Path(__file__).parents[1]
GENERATED = {"commands.md", "glossary.md", "python.md"}  # when the site is built
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _toml(page: str, heading: str) -> str:
    """The first block of TOML under a heading."""
    return re.findall(r"```toml\n(.*?)```", _text(page).split(heading)[1], re.S)[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_links_only_to_pages_that_exist(page):
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    pages = [link for link in links if not link.endswith(".png")]  # made by a run
    pages = [link for link in pages if Path(link).name not in GENERATED]
    assert [link for link in pages if not (page.parent / link).exists()] == []


def _described_effects() -> dict[str, dict[str, str]]:
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([^|]+) \|$", pages.effects_table(), re.M)
    group = re.compile(r"((?:`\w+`(?:, )?)+) \[([^\]]+)\]")  # `cos`, `sin` [N m]
    return {
        name: {
            key: unit
            for keys, unit in group.findall(parameters)
            for key in re.findall(r"`(\w+)`", keys)
        }
        for name, parameters in rows
    }


def test_the_effects_table_has_every_name_parameter_and_unit():
    assert _described_effects() == vocabulary()


def test_the_table_of_named_queries_has_all_of_them_and_their_values():
    table = pages.named_queries_table()
    assert sorted(re.findall(r"^\| `(\w+)` \|", table, re.M)) == sorted(NAMED)
    keys = [key for values in TAKES.values() for key in values]
    assert sorted(re.findall(r"--with (\w+)=", table)) == sorted(keys)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_asks_only_for_tables_that_are_generated(page):
    named = re.findall(r"<!-- generated: (\w+) -->", page.read_text(encoding="utf-8"))
    assert set(named) <= set(pages.TABLES)


def test_the_pages_stay_at_half_of_their_words():
    """At most 30 000 words with the measured pages, 700 of them in the README."""
    words = {page: len(page.read_text(encoding="utf-8").split()) for page in PAGES}
    measured = sum(n for p, n in words.items() if p.stem.startswith("benchmarks"))
    assert words[ROOT / "README.md"] <= 700
    assert sum(words.values()) - measured <= 24_500


def test_the_glossary_has_every_noun_once():
    table = pages.glossary_page().partition("Arrays have")[0]
    nouns = re.findall(r"^\| ([a-z][\w ,-]*) \| ", table, re.M)[1:]
    single = [word for noun in nouns for word in noun.split(", ")]
    assert len(set(single)) == len(single) > 40
    assert nouns == sorted(nouns)


def test_the_example_of_a_map_is_read(tmp_path):
    path = tmp_path / "COLUMNS.toml"
    path.write_text(_toml("docs/logs.md", "## COLUMNS.toml"), encoding="utf-8")
    columns = load_columns(path)
    assert columns.time_unit == "ms"
    assert columns.signals["q"].sign == (1, -1)


def test_the_example_of_a_robot_file_is_read():
    where = "docs/logs.md"
    content = parse_toml(_toml(where, "## robot.toml"), where)
    robot = read_robot_toml(content, 2, where, vocabulary())
    assert set(robot["declared"]) == {"coulomb", "viscous"}
    assert robot["prior_scale"] == 0.03


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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_names_only_files_and_folders_of_code_that_are_there(page):
    folders = ("residual", "flows", "sim", "warehouse", "benchmarks", "tests")
    there = {
        f"/{path.relative_to(ROOT).as_posix()}"
        for folder in folders
        for path in (ROOT / folder).rglob("*")
    }
    # The example of an effect.
    new = ("/creaking.py", "/residual/effects/creaking.py")
    there |= {"/modelgap.py", *new}
    text = page.read_text(encoding="utf-8")
    if page.name == "CHANGELOG.md":  # tells of what was, too
        text = text.split("\n## ")[0]
    files = re.findall(r"`((?:\w+/)*\w+\.py)`", text)
    roots = "|".join(folders)
    files += re.findall(rf"`((?:{roots})/[\w/]*\w)/?`", text)
    assert [f for f in files if not any(p.endswith(f"/{f}") for p in there)] == []
