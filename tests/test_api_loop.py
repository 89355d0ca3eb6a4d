"""The loop from a script: simulate, watch, ask for the next motion."""

import pytest

import modelgap as mg

SHORT = {"trajectory": {"kind": "cyclic", "duration": 5.0}}
SHORT["rates"] = {"control": 500, "log": 125}
STIFF = {"plant": {"effect": [{"name": "coulomb", "joints": [2], "level": 30.0}]}}


@pytest.fixture(scope="module")
def healthy():
    return [mg.simulate({**SHORT, "seed": seed}) for seed in range(4)]


def test_a_joint_that_got_stiff_is_told_and_a_healthy_one_is_not(healthy):
    model = mg.identify(mg.load_robot("irb140"), healthy[:3]).models["identified"]
    odd = mg.simulate({**SHORT, **STIFF, "seed": 9})
    report = mg.monitor(model, healthy[:3], [odd, healthy[3]])
    assert 2 in {alarm.joint for alarm in report.alarms[odd.id]}
    assert 2 not in {alarm.joint for alarm in report.alarms[healthy[3].id]}


def test_what_is_simulated_twice_is_one_log(healthy):
    again = mg.simulate({**SHORT, "seed": 0})
    assert again.id == healthy[0].id
    assert (again.tau == healthy[0].tau).all()
    with pytest.raises(mg.InputError, match=again.id):
        mg.monitor(None, [*healthy[:2], again], healthy[3:])


def test_what_cannot_be_asked_is_refused_before_anything_is_fitted():
    with pytest.raises(mg.InputError, match="expected 4 to 600"):
        mg.next_experiment(mg.load_robot("irb140"), [], seconds=1.0)


def test_an_unknown_key_of_an_experiment_is_refused():
    with pytest.raises(mg.InputError, match="trajectry"):
        mg.simulate({"trajectry": {}})
