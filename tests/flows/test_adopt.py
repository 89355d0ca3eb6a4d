"""From a diagnosis to the model of a robot, and back again."""

from dataclasses import replace
from shutil import copytree, rmtree

import numpy as np
import pytest

from flows import storage as keep
from flows.cli import main
from flows.inputs import load_run_robot
from flows.steps import rerun as reruns
from flows.steps.model_choice import (
    adopt,
    choose_model,
    choose_monitor_model,
    list_adoptions,
    roll_back,
)
from flows.storage import read_adoptable_model, read_models, read_verdict
from residual.diagnosis.adoption import check_adoption
from residual.errors import InputError
from tests.flows.adopted_arm import ROBOT, SERIAL, diagnosed, unchecked
from warehouse.queries import open_store
from warehouse.store_catalogue import (
    describe_diagnosis_adoption,
    find_last_adoption,
    find_record,
    read_record,
    read_run,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def night_store(arm_nights):
    return arm_nights.store, arm_nights.first, arm_nights.second, arm_nights.id


@pytest.fixture
def fresh(night_store):
    """The same with the nominal model in force: tests leave nothing adopted."""
    store = night_store[0]
    yield night_store
    while (last := find_last_adoption(store, ROBOT, SERIAL)) and last[1].model_id:
        roll_back(None, store=store)


def test_after_adoption_the_next_diagnosis_finds_nothing(fresh, arm_nights):
    store, *_, id = fresh
    assert [e.name for e in read_verdict(store, id).effects] == ["spring"]
    number, judgment = adopt(id, "seen twice", store=store)
    assert judgment.check.after < 0.2 * judgment.check.before
    again = arm_nights.again
    assert read_verdict(store, again).effects == ()
    assert "spring" in read_verdict(store, again).declared
    with open_store(store) as opened:
        query = "SELECT adoption_id, diagnosis_id, note FROM adopted"
        assert opened.sql(query).to_pylist() == [
            {"adoption_id": number, "diagnosis_id": id, "note": "seen twice"}
        ]
        kin = f"SELECT parent FROM lineage WHERE child = '{again}' AND role = 'nominal'"
        assert opened.sql(kin).column(0).to_pylist() == [id]


def test_commands_on_runs_go_by_it_and_say_so_and_those_on_files_do_not(fresh):
    store, first, _, id = fresh
    adopt(id, store=store)
    runs = first[0]
    robot = load_run_robot(ROBOT, runs, store)
    on_runs = choose_model(robot, store=store, logs=runs)
    assert on_runs.diagnosis == id
    assert "adoption" in on_runs.line
    assert id[:8] in on_runs.line
    assert choose_model(robot, logs=("A.csv",)).diagnosis is None
    assert choose_model(robot, store=store, logs=("A.csv",)).diagnosis == id
    nominal = choose_model(robot, "nominal", store, runs)
    assert nominal.diagnosis is None
    assert "nominal" in nominal.line
    healthy = choose_model(robot, None, store, runs, "--baseline")
    assert healthy.diagnosis is None
    assert "--baseline" in healthy.line
    with pytest.raises(InputError, match="both set the nominal model"):
        choose_model(robot, id, store, runs, "--baseline")
    assert choose_model(robot, id[:6], store, runs).diagnosis == id
    assert choose_monitor_model(ROBOT, store, False, runs).diagnosis == id
    assert choose_monitor_model(ROBOT, store, True, runs).diagnosis is None
    assert choose_monitor_model(id[:8], store, nominal=False).line is None


@pytest.mark.long
def test_a_rerun_goes_by_the_model_of_then(fresh, arm_nights):
    store, *_, id = fresh
    adopt(id, store=store)
    roll_back(ROBOT, store=store)
    outcome = reruns.rerun(arm_nights.again, store, True)
    assert (list(outcome.differences), outcome.cause) == ([], None)


def test_identify_starts_from_it_and_so_does_its_rerun(fresh, capsys):
    store, _, (fit, held_out), id = fresh
    adopt(id, store=store)
    words = ["identify", fit[0], "--robot", ROBOT, "--holdout", *held_out]
    with unchecked():
        assert main([*words, "--store", str(store)]) == 0
        output = capsys.readouterr().out
        assert "model: adoption" in "\n".join(output.splitlines()[:2])
        kept = output.split("modelgap show ")[1].split()[0]
        record = read_record(store, kept)
        assert record["request"]["model"] == id
        assert "spring" in {t["name"] for t in record["model"]["terms"]}
        roll_back(ROBOT, store=store)
        assert reruns.rerun(kept, store, True).differences == ()


def test_rolling_back_is_one_more_record_and_deletes_nothing(fresh):
    store, (fit, _), _, id = fresh
    before = list_adoptions(store)
    number, _ = adopt(id, store=store)
    assert describe_diagnosis_adoption(store, id).endswith("the current model")
    back, now = roll_back(None, "too many alarms", store)
    assert describe_diagnosis_adoption(store, id).endswith("replaced since")
    assert (now.parent, now.model_id, now.note) == (number, None, "too many alarms")
    listed = [n for n, *_ in list_adoptions(store)]
    assert listed == [*(n for n, *_ in before), number, back]
    robot = load_run_robot(ROBOT, fit, store)
    line = choose_model(robot, store=store).line
    assert f"restored by adoption {int(back)}" in line
    with pytest.raises(InputError, match="nothing to roll back"):
        roll_back(None, store=store)


def test_what_names_nothing_is_refused_unless_forced_with_a_reason(fresh, arm_nights):
    store, *_, id = fresh
    nothing = arm_nights.again
    with pytest.raises(InputError, match="names no missing effect"):
        adopt(nothing, store=store)
    with pytest.raises(InputError, match="needs a --note"):
        adopt(nothing, force=True, store=store)
    adopt(nothing, "asked for by the line", True, store)
    assert find_last_adoption(store, ROBOT, SERIAL)[1].action == "forced"
    adopt(id, "over it", True, store)
    with pytest.raises(InputError, match="already has that model"):
        adopt(id, store=store)
    _, back = roll_back(ROBOT, store=store)
    assert back.diagnosis_id == nothing


def _wrong(model, how):
    """The model with its spring of another sign, on another joint, or twice."""
    (spring,) = [t for t in model.terms if t.effect.name == "spring"]
    changed = {
        "right": spring,
        "sign": replace(spring, theta=-spring.theta),
        "joint": replace(spring, joints=(0,)),
        "twice": replace(spring, theta=2 * spring.theta),
    }[how]
    terms = (changed if t is spring else t for t in model.terms)
    return replace(model, terms=tuple(terms))


@pytest.mark.parametrize(
    ("how", "part"), [("right", 1.0), ("sign", -1.0), ("joint", 0.0), ("twice", 0.5)]
)
def test_a_wrong_correction_is_refused_on_another_night(night_store, how, part):
    store, _, second, id = night_store
    before = read_models(store, id)["nominal"]
    model = _wrong(read_adoptable_model(store, id), how)
    seen = check_adoption(model, before, [read_run(store, run) for run in second[1]])
    (spring,) = seen.effects
    assert spring.part == pytest.approx(part, abs=0.15)
    assert (not seen.doubts) == (how == "right")


def test_what_changed_since_needs_the_runs_behind_the_model(night_store, monkeypatch):
    store, first, second, id = night_store
    with pytest.raises(InputError, match="got none"):
        diagnosed(store, (first[0] + first[1], second[1]), model=id)
    ids = list(keep.read_runs(store, id, ("fit", "held_out")))
    assert ids == [*first[0], *first[1]]
    gone = "f" * len(ids[0])
    monkeypatch.setattr(keep, "read_runs", lambda *_: (*ids, gone))
    monkeypatch.setattr(keep, "read_motion", lambda *_: ())
    with pytest.raises(InputError, match="or give logs of that time with --baseline"):
        diagnosed(store, second, model=id)


@pytest.mark.long
def test_a_model_without_its_runs_has_their_motion(night_store, arm_nights, tmp_path):
    store, first, second, id = night_store
    copy = tmp_path / "store"
    copytree(store, copy)
    for run in (*first[0], *first[1]):
        rmtree(find_record(copy, run).folder)
    motion = keep.read_motion(copy, id)
    assert [m.id for m in motion] == [*first[0], *first[1]]
    run = read_run(store, first[0][0])
    at = np.interp(motion[0].t, run.t, run.q[:, 0])
    assert np.abs(at - motion[0].q[:, 0]).max() < 1e-3 * np.ptp(at)
    verdicts = [
        read_verdict(store, arm_nights.again),
        read_verdict(copy, diagnosed(copy, second, model=id)),
    ]
    assert verdicts[0].effects == verdicts[1].effects == ()
    # None where nothing that the arm can have would show.
    sizes = [[d.value or np.nan for d in v.minimum_detectable] for v in verdicts]
    assert np.isfinite(sizes[0]).mean() > 0.7
    ratio = np.array(sizes[1]) / sizes[0]
    ratio = ratio[np.isfinite(ratio)]
    # Its own samples are gone: what turns on single ones of them may differ by more.
    assert np.mean(np.abs(ratio - 1) < 0.1) > 0.98
    assert 0.5 < ratio.min() < ratio.max() < 2


def test_the_list_says_which_model_is_in_force(fresh, capsys):
    store, *_, id = fresh
    assert main(["adopt", id[:8], "--note", "why", "--store", str(store)]) == 0
    assert "error on unseen motion" in capsys.readouterr().out
    assert main(["models", "--robot", ROBOT, "--store", str(store)]) == 0
    output = capsys.readouterr().out
    assert "adopted" in output
    assert "why" in output
    assert " *" in output
    assert main(["rollback", "--store", str(store)]) == 0
    assert "is back at its nominal model" in capsys.readouterr().out
