"""The JSON schemas accept what the readers accept, and refuse what they refuse."""

import json
import re
import tomllib
from functools import cache

import pytest
from jsonschema import Draft202012Validator, ValidationError

from residual.effects import list_effect_parameters
from residual.errors import InputError
from residual.robot.files import parse_robot_settings
from residual.verdict.document import from_json
from scripts.docs_site.schemas import schemas
from tests.checkout import ROOT
from warehouse.logs.column_map import read_column_map

FROZEN = [ROOT / "tests" / "frozen" / f"{n}.json" for n in ("effects", "none", "unknown")]


@cache
def validator(name: str) -> Draft202012Validator:
    schema = schemas()[f"schemas/{name}.json"]
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def validate(name: str, document) -> None:
    validator(name).validate(document)


def block(page: str, heading: str) -> str:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8").split(heading)[1]
    return re.findall(r"```toml\n(.*?)```", text, re.S)[0]


def example(page: str, heading: str) -> dict:
    return tomllib.loads(block(page, heading))


@pytest.mark.parametrize("path", FROZEN, ids=lambda path: path.stem)
def test_a_real_verdict_fits_its_schema(path):
    validate("verdict", json.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("place", [(), ("error",), ("unexplained",), ("effects", 0)])
def test_a_verdict_with_another_key_or_without_one_is_refused(place):
    for change in (lambda part: part.update(more=1), lambda part: part.popitem()):
        verdict = json.loads(FROZEN[0].read_text(encoding="utf-8"))
        part = verdict
        for key in place:
            part = part[key]
        change(part)
        with pytest.raises(ValidationError):
            validate("verdict", verdict)


def test_the_example_of_a_verdict_fits_its_schema_and_is_read():
    text = (ROOT / "docs" / "verdict.md").read_text(encoding="utf-8")
    verdict = json.loads(re.search(r"```json\n(.*?)```", text, re.S)[1])
    validate("verdict", verdict)
    assert from_json(verdict).effects[0].name == "payload"


def test_the_example_of_a_robot_has_every_key_of_the_schema_and_is_read():
    robot = example("logs.md", "## robot.toml")
    validate("robot", robot)
    parse_robot_settings(robot, 2, "robot.toml", list_effect_parameters())
    tables = schemas()["schemas/robot.json"]["properties"]
    assert set(tables) - set(robot) == {"columns"}
    for name in ("robot", "joints", "couplings", "chain", "prior"):
        assert set(tables[name]["properties"]) == set(robot[name])


@pytest.mark.parametrize(
    "wrong",
    [
        {"robot": {"nam": "x"}},
        {"robot": {"gravity": [0, 0]}},
        {"joint": {}},
        {"joints": {"torque_limit": [0, 1]}},
        {"prior": {"scale": -1}},
        {"declared": {"colomb": {}}},
        {"declared": {"coulomb": {"levle": [1, 2]}}},
    ],
)
def test_reader_and_schema_refuse_the_same_robot(wrong):
    with pytest.raises(ValidationError):
        validate("robot", wrong)
    with pytest.raises(InputError):
        parse_robot_settings(wrong, 2, "robot.toml", list_effect_parameters())


def test_a_map_of_columns_fits_and_a_slip_in_it_does_not(tmp_path):
    text = block("logs.md", "## COLUMNS.toml")
    columns = tomllib.loads(text)
    validate("columns", columns)
    wrong = columns | {"q": columns["q"] | {"sgn": [1, -1]}}
    with pytest.raises(ValidationError):
        validate("columns", wrong)
    path = tmp_path / "COLUMNS.toml"
    path.write_text(text, encoding="utf-8")
    assert read_column_map(path).signals["q"].sign == (1, -1)
    path.write_text('q = {columns = ["a", "b"], sgn = [1, -1]}', encoding="utf-8")
    with pytest.raises(InputError):
        read_column_map(path)


def test_a_spec_fits_and_a_slip_in_it_does_not():
    spec = example("experiments.md", "# Experiments")
    validate("spec", spec)
    validate("spec", spec | example("experiments.md", "## Campaigns"))
    with pytest.raises(ValidationError):
        validate("spec", spec | {"sed": 7})
