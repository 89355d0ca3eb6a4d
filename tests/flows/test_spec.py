"""SPEC.toml and campaigns: what they mean, their ids, and what does not fit."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from flows.specs import derive_seed, load_campaign, load_spec, parse_spec
from flows.steps import demo, experiment
from flows.steps.experiment import build_public_record as public_record
from flows.steps.experiment import (
    build_sealed_record,
    compute_run_id,
    load_spec_robot,
    plan_experiments,
)
from residual.errors import InputError
from sim.engine.plant_records import PlantEffect as Effect
from sim.engine.plant_records import SampleRates, SensorNoise, TrajectorySpec
from tests.checkout import ROOT

SPEC = """
schema = 1
robot = "irb140"
seed = 7
[trajectory]
kind = "fourier"
duration = 20.0
periods = 2
[plant]
scatter = 0.02
noise = {torque = 0.015, encoder = 1e-4}
[[plant.effect]]
name = "stribeck"
joints = [3]
level = 4.0
velocity = 0.05
onset = 0.0
[rates]
control = 1000
log = 250
"""


def spec(old: str = "", new: str = ""):
    assert old in SPEC
    return parse_spec(tomllib.loads(SPEC.replace(old, new)), "SPEC.toml")


def test_the_documented_example_becomes_the_records_of_plant_and_motion():
    experiment = spec()
    assert experiment.reference() == TrajectorySpec("fourier", 20.0, 2, derive_seed(7, "reference"))
    plant = experiment.plant_spec()
    effect = Effect("stribeck", (3,), (("level", 4.0), ("velocity", 0.05)), 0.0)
    assert plant.effects == (effect,)
    assert (plant.scatter, plant.noise) == (0.02, SensorNoise(0.015, 1e-4))
    assert experiment.log_rates() == SampleRates(1000.0, 250.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("seed = 7", "sede = 7", "did you mean 'seed'"),
        ("[rates]", "[gird]", "key in the file 'gird': did you mean 'grid'"),
        ("plant.effect", "effect", "did you mean 'plant.effect'"),
        ("seed = 7", 'seed = "7"', "seed is '7', expected a whole number"),
        ("seed = 7", "seed = true", "seed is True, expected a whole number"),
        ("seed = 7", "seed = -1", "seed is -1, expected greater than or equal to 0"),
        ("schema = 1", "schema = 2", "schema is 2, expected 1"),
        ("periods = 2", "period = 2", r"\[trajectory\] 'period': did you mean 'per"),
        ('"fourier"', '"forier"', "kind 'forier': did you mean 'fourier'"),
        ("20.0", "0.0", r"\[trajectory\] duration is 0.0, expected greater than 0"),
        ("20.0", "nan", r"\[trajectory\] duration is nan, expected a finite number"),
        ("scatter", "scater", r"\[plant\] 'scater': did you mean 'scatter'"),
        ("torque = ", "torqe = ", r"\[plant.noise\] 'torqe': did you mean 'torque'"),
        ('name = "stribeck"', "", r"\[\[plant.effect\]\] 1 needs the key 'name'"),
        ("[3]", "3", r"\[\[plant.effect\]\] 1 joints is 3, expected a list"),
        ("[3]", "[0]", r"joints \(entry 1\) is 0, expected greater than"),
        ("level = 4.0", 'level = "x"', "level is 'x', expected a number"),
        ("log = 250", "log = 300", "control must be a whole multiple of log"),
        ("[rates]", "[grid]", "so it is a campaign. Run modelgap campaign"),
    ],
)
def test_a_slip_is_told_with_its_place_and_what_was_expected(old, new, said):
    with pytest.raises(InputError, match=said):
        spec(old, new)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"stribeck"', '"stribek"', "did you mean 'stribeck'"),
        ("level = 4.0", "leval = 4.0", "did you mean 'level'"),
        ("[3]", "[7]", "7"),
        ('robot = "irb140"', 'robot = "irb14"', "did you mean 'irb140'"),
    ],
)
def test_what_robot_or_plant_lack_is_told_before_anything_runs(old, new, said):
    with pytest.raises(InputError, match=said):
        compute_run_id(spec(old, new))


def test_a_wrong_effect_is_told_with_its_file_and_names_alone(tmp_path):
    with pytest.raises(InputError) as told:
        plan_experiments([("a/S.toml", spec('"stribeck"', '"hose"'))], tmp_path)
    assert str(told.value).startswith("S.toml: Unknown effect of the plant 'hose'")
    assert "x_" not in str(told.value)
    with pytest.raises(InputError, match=r"C: seed=1: .* 'x_wal': did you mean 'x_wal"):
        plan_experiments([("seed=1", spec('"stribeck"', '"x_wal"'))], tmp_path, "C")


def test_a_missing_or_broken_file_is_told(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        load_spec(tmp_path / "SPEC.toml")
    (tmp_path / "SPEC.toml").write_text("seed = = 1")
    with pytest.raises(InputError, match="not valid TOML"):
        load_spec(tmp_path / "SPEC.toml")


def test_a_robot_beside_the_spec_is_found_from_anywhere(tmp_path):
    (tmp_path / "my.urdf").write_text("<robot/>")
    (tmp_path / "SPEC.toml").write_text('robot = "my.urdf"')
    assert load_spec(tmp_path / "SPEC.toml").robot == str(tmp_path / "my.urdf")


def test_the_open_half_tells_nothing_of_what_is_hidden():
    robot = load_spec_robot(spec())
    plain = public_record(spec(), robot)
    for old, new in (
        ("level = 4.0", "level = 5.0"),
        ("scatter = 0.02", "scatter = 0.01"),
        ("torque = 0.015", "torque = 0.03"),
    ):
        assert public_record(spec(old, new), robot) == plain
        assert build_sealed_record(spec(old, new).plant_spec()) != build_sealed_record(
            spec().plant_spec()
        )
        assert compute_run_id(spec(old, new)) != compute_run_id(spec())


def test_the_seeds_of_motion_and_arm_are_their_own_and_no_effect_moves_them():
    experiment = spec()
    assert experiment.reference().seed != experiment.plant_spec().seed
    same = spec("periods = 2", "periods = 2\nseed = 5")
    assert same.plant_spec() == experiment.plant_spec()
    assert same.reference().seed == 5
    without = spec(SPEC[SPEC.index("[[plant") : SPEC.index("[rates]")])
    assert without.plant_spec().seed == spec().plant_spec().seed
    assert without.reference() == spec().reference()


CAMPAIGN = """
seed = 3
[[plant.effect]]
name = "spring"
joints = [2]
stiffness = 4.0
"""


def entries(tmp_path, text: str, seed=None):
    path = tmp_path / "C.toml"
    path.write_text(CAMPAIGN + text)
    return load_campaign(path, seed)


def test_a_grid_is_every_combination_the_last_key_fastest(tmp_path):
    grid = '[grid]\ntrajectory.kind = ["fourier", "cyclic"]\n'
    designs = entries(tmp_path, grid + "plant.effect.stiffness = [1.0, 2.0]\n")
    specs = [e.spec for e in designs]
    springs = [s.plant_spec().effects[0].parameters[0][1] for s in specs]
    got = list(zip((s.trajectory.kind for s in specs), springs, strict=True))
    assert got == [("fourier", 1), ("fourier", 2), ("cyclic", 1), ("cyclic", 2)]
    assert designs[0].label == "trajectory.kind=fourier plant.effect.stiffness=1"


def test_another_seed_for_the_night_moves_what_the_file_leaves_open(tmp_path):
    grid = "[grid]\nplant.seed = [1]\n"
    (one,), (other,) = (entries(tmp_path, grid, seed) for seed in (None, 20261121))
    assert one.spec.plant_spec() == other.spec.plant_spec()
    assert one.spec.reference().seed != other.spec.reference().seed


def test_a_further_key_of_a_random_design_leaves_the_others_as_drawn(tmp_path):
    draws = "[random]\ncount = 4\nplant.effect.stiffness = {low = 1.0, high = 9.0}\n"
    few = entries(tmp_path, draws)
    more = entries(tmp_path, draws + "trajectory.duration = {low = 5, high = 9}\n")
    sizes = [[e.spec.plant_spec().effects for e in made] for made in (few, more)]
    assert sizes[0] == sizes[1]
    assert len({e.spec.seed for e in few}) == 4
    assert all(e.spec.trajectory.duration.is_integer() for e in more)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "neither of"),
        ("[grid]\nseed = [1]\n[random]\ncount = 1\n", "both of"),
        ("[grid]\nseed = 1\n", "seed is 1, expected a list"),
        ("[grid]\nseed = []\n", "expected a list of values"),
        ("[grid]\n", "asks for 0 runs"),
        (f"[grid]\nseed = {list(range(10001))}\n", "asks for 10001 runs"),
        ("[grid]\ntrajectory.kid = ['x']\n", "did you mean 'kind'"),
        ("[grid]\nplant.effect.2.stiffness = [1.0]\n", "there are 1 of these"),
        ("[grid]\nseed.x = [1]\n", "does not name a key"),
        ("[random]\nseed = [1]\n", "count is None"),
        ("[random]\ncount = 2\nseed = {low = 3, high = 1}\n", "expected low < high"),
        ("[random]\ncount = 2\nseed = {low = 3, hgh = 5}\n", "did you mean 'high'"),
    ],
)
def test_a_design_that_cannot_be_is_told(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        entries(tmp_path, text)


def test_the_examples_of_the_page_are_what_it_says(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "experiments.md").read_text()
    whole, grid, draws = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "SPEC.toml").write_text(whole)
    example = load_spec(tmp_path / "SPEC.toml")
    plain = parse_spec({"seed": 7}, "SPEC.toml")
    assert example.plant.effect[0].name == "stribeck"
    hidden = example.plant.model_copy(update={"effect": ()})
    assert example.model_copy(update={"plant": hidden}) == plain
    for design, count in ((grid, 6), (draws, 50)):
        (tmp_path / "C.toml").write_text(whole + design)
        assert len(load_campaign(tmp_path / "C.toml")) == count


# Ids of runs move for nobody: those of specs are as ab4d41df computed them.


IDS = json.loads(Path(__file__).with_name("run_ids.json").read_text())


def read_tables(page: str) -> list[str]:
    text = (ROOT / "docs" / page).read_text("utf-8")
    return re.findall(r"```toml[^\n]*\n(.*?)```", text, re.DOTALL)


@pytest.fixture
def specs(tmp_path):
    tables = read_tables("experiments.md")
    spec = next(t for t in tables if t.startswith("schema = 1"))
    axes = {t[1:5]: t for t in tables if t.startswith(("[grid]", "[random]"))}
    (guide,) = (t for t in read_tables("guide/first_hour.md") if "[grid]" in t)
    texts = {"spec": spec, "guide": guide}
    texts |= {name: spec + table for name, table in axes.items()}
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text)
    out = {"spec": load_spec(tmp_path / "spec.toml")}
    shown = demo.build_demo_specs(7)
    out |= {f"demo {i}": shown[i][1] for i in (0, 3, 7)}
    paths = [tmp_path / f"{name}.toml" for name in ("guide", *axes)]
    for path in (*paths, *sorted((ROOT / "examples").glob("*.toml"))):
        some = load_campaign(path)[:4]
        out |= {f"{path.stem} {i}": entry.spec for i, entry in enumerate(some)}
    return out


def test_the_ids_of_specs_are_those_that_they_always_had(specs, monkeypatch):
    monkeypatch.setattr(experiment, "hash_plant_code", lambda: "0" * 64)
    ids = {name: experiment.compute_run_id(spec) for name, spec in specs.items()}
    assert len(set(ids.values())) >= 20
    assert ids == IDS
