"""The pages say what the program does."""

import re
from pathlib import Path

import pytest

from flows.cli.app import app
from residual.effects import vocabulary
from residual.model.nominal import DEFAULT_DECLARED
from residual.robot.files import parse_toml, read_robot_toml
from warehouse.logs.columns import load_columns

ROOT = Path(__file__).parents[1]
MADE = {"commands.md"}  # when the site is built
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
    pages = [link for link in pages if Path(link).name not in MADE]
    assert [link for link in pages if not (page.parent / link).exists()] == []


def _described_effects() -> dict[str, dict[str, str]]:
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([^|]+) \|$", _text("docs/effects.md"), re.M)
    group = re.compile(r"((?:`\w+`(?:, )?)+) \[([^\]]+)\]")  # `cos`, `sin` [N m]
    return {
        name: {
            key: unit
            for keys, unit in group.findall(parameters)
            for key in re.findall(r"`(\w+)`", keys)
        }
        for name, parameters in rows
    }


def test_the_effects_page_has_every_name_parameter_and_unit():
    assert _described_effects() == vocabulary()


def test_the_effects_page_reserves_what_no_file_implements():
    folder = {path.stem for path in (ROOT / "residual" / "effects").glob("*.py")}
    reserved = re.search(r"## Reserved(.*?)##", _text("docs/effects.md"), re.S)[1]
    named = set(re.findall(r"`(\w+)`", reserved))
    assert named == set(vocabulary()) - folder


def test_the_glossary_has_every_word_once_and_no_effect():
    _, verdicts, others = re.split(r"^## .*", _text("docs/glossary.md"), flags=re.M)
    words = re.findall(r"^### (.+)$", others, re.M)
    assert words == sorted(words)
    every = [*re.findall(r"^### (.+)$", verdicts, re.M), *words]
    assert len(set(every)) == len(every) > 40
    assert not set(every) & set(vocabulary())


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
