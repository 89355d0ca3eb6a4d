"""What an arm may hide is one file in sim/effects, and nothing else knows its name."""

import sys
from pathlib import Path

import numpy as np
import pytest

from residual.effects import registry as sought
from residual.errors import InputError
from sim import effects
from sim.catalogue import check_effect, kinds, of_drives, vocabulary
from sim.draw import draw, draw_hidden, usual_effects
from sim.effects import registry
from sim.experiment import run_experiment
from sim.records import Noise, PlantSpec
from sim.synthetic.motion import make_motion
from sim.synthetic.plant import Plant, true_torque
from sim.synthetic.room import room
from sim.synthetic.seeds import stream
from sim.synthetic.state import Hidden
from tests.sim.plant_cases import ROBOT, effect, motion

FOLDER = Path(effects.__file__).parent
CREAKING = """
from sim.effects.base import Effect

EFFECT = Effect(
    name="creaking",
    parameters={"level": "N m"},
    amount=("level",),
    usual=lambda rng, here: {"level": rng.uniform(0.1, 0.2) * here.torque},
    push=lambda p, model, data, q, qd: -p["level"] * q**3,
    law=lambda state, p: p["level"] * state.q**3,
)
"""


@pytest.fixture
def creaking(tmp_path, monkeypatch):
    """An effect that was dropped into the folder."""
    (tmp_path / "creaking.py").write_text(CREAKING)
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    registry.cache_clear()
    yield "creaking"
    sys.modules.pop("sim.effects.creaking", None)
    registry.cache_clear()


def test_the_registry_is_the_folder():
    files = {p.stem for p in FOLDER.glob("[!_]*.py")} - {"base"}
    kin = {"unnamed", "broken_sensors", "other_forms"}
    assert files - kin == set(vocabulary())
    assert kin < files
    assert all(name == known.name for name, known in registry().items())


def test_the_plant_can_have_what_the_diagnosis_looks_for_in_the_same_words():
    assert set(vocabulary()) == set(sought())
    for name in vocabulary():
        assert dict(registry()[name].parameters) == dict(sought()[name].parameters)


def test_one_new_file_is_an_effect_that_can_be_drawn_and_checked(creaking):
    assert creaking in kinds()
    assert creaking in usual_effects()
    drawn = draw_hidden(ROBOT, stream(1, "hidden"), creaking)
    check_effect(drawn, ROBOT)
    assert [key for key, _ in drawn.parameters] == ["level"]
    with pytest.raises(InputError, match="'level'"):
        check_effect(effect(creaking, 2, levle=1.0), ROBOT)


def test_one_new_file_acts_in_the_physics_engine_and_in_its_log(creaking):
    hidden, quiet = effect(creaking, 2, level=3.0), Noise(0.0, 0.0)
    run = run_experiment(ROBOT, motion(duration=2.1), PlantSpec((hidden,), noise=quiet))
    torque, q = run.truth["tau_creaking"], run.truth["q"]
    np.testing.assert_allclose(torque, 3.0 * q**3, atol=1e-12)
    assert np.abs(torque).max() > 0.1
    rest = sum(run.truth[f"tau_{name}"] for name in ("rigid", "rotor", "friction"))
    np.testing.assert_allclose(run.log.tau - rest, torque, atol=1e-9)


def test_one_new_file_acts_on_the_synthetic_arm(creaking):
    moved = make_motion("fourier", room(ROBOT), 8.0, 125.0, stream(1, "motion"))
    hidden = Hidden(creaking, (2,), {"level": 3.0})
    with_it, without = (
        true_torque(Plant(ROBOT, x, 1), moved, "log").tau for x in ((hidden,), ())
    )
    np.testing.assert_allclose(
        (with_it - without)[:, 1], 3.0 * moved.q[:, 1] ** 3, atol=1e-9
    )


def test_what_only_the_engine_has_is_refused_by_the_synthetic_arm():
    moved = make_motion("fourier", room(ROBOT), 4.0, 125.0, stream(1, "motion"))
    hidden = draw(ROBOT, "x_wall", stream(1, "hidden"))
    with pytest.raises(InputError, match="x_wall"):
        true_torque(Plant(ROBOT, (hidden,), 1), moved, "log")


def test_numbers_of_the_drives_are_known_by_what_they_are():
    assert [effect.of_drive for effect in of_drives()] == [
        "viscous",
        "coulomb",
        "rotor",
    ]
