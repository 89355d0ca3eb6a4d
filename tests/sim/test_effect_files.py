"""What an arm may hide is one file in sim/effects, and nothing else knows its name."""

from pathlib import Path

import numpy as np
import pytest

from residual.effects import load_effects as sought
from residual.effects.base import EffectTrait
from residual.errors import InputError
from sim import effects
from sim.effects import load_effects
from sim.engine.plant_records import PlantSpec, SensorNoise, create_random_stream
from sim.experiment import run_experiment
from sim.plant.effect_catalogue import check_effect, list_plant_effects
from sim.plant.effect_catalogue import list_named_effects as named_effects
from sim.plant.typical_sizes import draw_plant_effect, list_drawable_effects
from tests.sim.plant_cases import ROBOT, effect, motion

FOLDER = Path(effects.__file__).parent
SIZE = 4.0  # N m s/rad^2


def test_the_registry_is_the_folder():
    files = {p.stem for p in FOLDER.glob("[!_]*.py")} - {"base"}
    kin = {"unnamed", "broken_sensors"}
    assert files - kin == set(named_effects())
    assert kin < files
    assert all(name == known.name for name, known in load_effects().items())


def test_the_plant_can_have_what_the_diagnosis_looks_for_in_the_same_words():
    # What a drive does while it is on needs goals: the servos of sim/plant have it.
    usual = {k for k, e in sought().items() if EffectTrait.POWERED not in e.traits}
    assert set(named_effects()) == usual
    for name in named_effects():
        assert dict(load_effects()[name].parameters) == dict(sought()[name].parameters)


def test_one_new_file_is_an_effect_that_can_be_drawn_and_checked(new_effect):
    assert new_effect in list_plant_effects()
    assert new_effect in list_drawable_effects()
    drawn = draw_plant_effect(ROBOT, create_random_stream(1, "hidden"), new_effect)
    check_effect(drawn, ROBOT)
    assert [key for key, _ in drawn.parameters] == ["coefficient"]
    with pytest.raises(InputError, match="'coefficient'"):
        check_effect(effect(new_effect, 2, coeficient=1.0), ROBOT)


def test_one_new_file_acts_in_the_physics_engine_and_in_its_log(new_effect):
    hidden, quiet = effect(new_effect, 2, coefficient=SIZE), SensorNoise(0.0, 0.0)
    run = run_experiment(ROBOT, motion(duration=2.1), PlantSpec((hidden,), noise=quiet))
    torque = run.truth["tau_creaking"]
    expected = SIZE * run.truth["q"] * run.truth["qd"] * (np.arange(6) == 1)
    np.testing.assert_allclose(torque, expected, atol=1e-12)
    assert np.abs(torque).max() > 0.1
    rest = sum(run.truth[f"tau_{name}"] for name in ("rigid", "rotor", "friction"))
    np.testing.assert_allclose(run.log.tau - rest, torque, atol=1e-9)
