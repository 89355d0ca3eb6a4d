"""An arm driven by any model: how it tracks, before and after, and what is kept."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter1d

from flows.requests import Validate
from flows.specs import parse_spec
from flows.steps import experiment
from flows.steps import rerun as reruns
from flows.steps.fit import read_controller_model
from flows.steps.rerun import compare_records
from flows.steps.rerun import remake_record as again
from flows.steps.validate import validate
from residual.calibration.calibrate import add_correction_tables
from residual.calibration.calibration_rows import name_state_columns
from residual.effects import load_effects
from residual.errors import InputError
from residual.export.model_export import to_json
from residual.model.dynamics import FrictionReversal, compute_feed_forward
from residual.model.lookup import LevelAxis, Lookup, LookupTable, build_lookup_files
from residual.model.model import Model, Term
from residual.robot.dynamics import read_inertial_parameters
from residual.robot.robot import load_robot
from sim.plant.typical_sizes import read_nominal_drives
from warehouse.queries import open_store
from warehouse.record_commit import commit_record
from warehouse.store_catalogue import find_record, read_manifest

ROBOT = load_robot("irb140")


def term(name, joint, *values):
    effect = load_effects()[name]
    theta, shape = effect.from_values(np.array(values), ROBOT)
    return Term(effect, (joint - 1,), tuple(shape), np.asarray(theta, float))


def nominal():
    """What the maker knows of the arm: body, friction and rotors."""
    names = ("coulomb", "viscous", "rotor_inertia")
    known = dict(zip(names, read_nominal_drives(ROBOT), strict=True))
    terms = [term(k, j + 1, v) for k, vs in known.items() for j, v in enumerate(vs)]
    return Model(ROBOT, read_inertial_parameters(ROBOT.model), tuple(terms))


def corrected(joint=2, stiffness=60.0):
    model = nominal()
    return replace(model, terms=(*model.terms, term("spring", joint, stiffness, 0.0)))


def friction_along(qd, turning, t):
    """Torque of Coulomb friction alone, where nothing else moves the arm [N m]."""
    still = np.zeros_like(qd), qd, np.zeros_like(qd)
    body = replace(nominal(), terms=())
    dry = tuple(t for t in nominal().terms if t.effect.name == "coulomb")
    models = replace(body, terms=dry), body
    with_it, without = (compute_feed_forward(m, t, still, turning) for m in models)
    return with_it - without


@given(rise=st.floats(0.01, 0.5), speed=st.floats(0.1, 5.0), turns=st.floats(0.5, 3))
@example(rise=0.5, speed=3.0, turns=2.75)  # a reversal between two samples
@settings(max_examples=20, deadline=None)
def test_friction_never_turns_faster_than_the_stated_torque_rate(rise, speed, turns):
    t = np.arange(2000) / 1000.0
    qd = speed * np.sin(2 * np.pi * turns * t)[:, None] * np.ones(6)
    turning = FrictionReversal(rise=rise)
    held, free = (friction_along(qd, x, t) for x in (turning, FrictionReversal(rise=0.0)))
    most = turning.compute_torque_rate(ROBOT) / 1000.0
    assert (np.abs(np.diff(held, axis=0)) <= most * (1 + 1e-9)).all()
    # Away from reversals, by half the time that a whole turn takes, it is what it was.
    # A reversal may fall between two samples: neither is then slower than their step.
    slow = np.abs(qd) < 0.02 + speed * 2 * np.pi * turns / 1000.0
    half = np.ceil(2 * read_nominal_drives(ROBOT)[0] / most).astype(int) // 2 + 1
    for j in range(6):
        near = maximum_filter1d(slow[:, j].astype(int), 2 * half[j] + 1) > 0
        np.testing.assert_allclose(held[~near, j], free[~near, j], atol=1e-6)


def kept(store, model):
    record = {"robot": ROBOT.name, "stage": "augmented", "model": model.to_record()}
    return commit_record(store, "models", record)


def tables(step=None):
    names = (*name_state_columns(range(1, 7)), *(f"tau{j}" for j in range(1, 7)))
    edges, axis = np.linspace(-2, 2, 201), 1
    values = np.zeros((len(edges) + 1, 6))
    values[:, 1] = 60.0 * np.r_[edges[0], (edges[:-1] + edges[1:]) / 2, edges[-1]]
    if step is not None:
        edges, axis, values = np.zeros(1), 7, np.zeros((2, 6))
        values[:, 1] = -step / 2, step / 2
    size = len(names)
    return Lookup(
        names,
        tuple(f"joint {j}" for j in range(1, 7)),
        (LevelAxis(axis, edges),),
        (LookupTable((0,), values),),
        np.zeros(6),
        np.zeros((size, 6)),
        np.full(size, -10.0),
        np.full(size, 10.0),
    )


def tabulated(step=None):
    return add_correction_tables(nominal(), tables(step), range(1, 7))


def spec(**controller):
    return parse_spec(
        {
            "trajectory": {"kind": "cyclic", "duration": 2.5, "periods": 1},
            "plant": {
                "scatter": 0.0,
                "effect": [{"name": "spring", "joints": [2], "stiffness": 60.0}],
                "noise": {"torque": 0.0},
            },
            "rates": {"control": 500, "log": 250},
            **({"controller": controller} if controller else {}),
        },
        "SPEC.toml",
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory, compiled_plant):
    store = tmp_path_factory.mktemp("store")
    model = kept(store, corrected())
    by_nominal = experiment.simulate_and_store(spec(), store)
    by_model = experiment.simulate_and_store(spec(model=model[:7]), store)
    return store, model, by_nominal, by_model


def test_a_spec_names_the_model_that_drives_and_the_run_keeps_its_whole_id(runs):
    store, model, by_nominal, by_model = runs
    half = read_manifest(store, by_model)["spec"]["controller"]
    assert half == {"kind": "computed_torque", "model": model}
    assert "controller" not in read_manifest(store, by_nominal)["spec"]
    with open_store(store) as db:
        query = f"SELECT parent, role FROM lineage WHERE child = '{by_model}'"
        assert db.sql(query).to_pylist() == [{"parent": model, "role": "controller"}]
    # The same spec is the same run, however the model is named.
    assert experiment.simulate_and_store(spec(model=model), store) == by_model
    other = experiment.simulate_and_store(spec(model=model, kind="feed_forward"), store)
    assert other not in (by_model, by_nominal)


def test_a_rerun_is_driven_by_the_model_of_then(runs):
    store, _, _, by_model = runs
    outcome = reruns.rerun(by_model, store, True)
    assert (list(outcome.differences), outcome.cause) == ([], None)


@pytest.fixture(scope="module")
def validated(runs):
    store, model, run, _ = runs
    return validate(Validate(run, 0.25, store, model[:8]))


def test_a_right_model_is_better_both_ways_and_the_arm_tracks_better(runs, validated):
    store, model, run, _ = runs
    id, validation = validated
    assert list(validation.models) == ["nominal", "model"]
    nominal, better = validation.models.values()
    # The spring on joint 2 is all that the nominal model lacks.
    assert better.torque[1] < 0.1 * nominal.torque[1]
    assert better.acceleration[1] < 0.1 * nominal.acceleration[1]
    assert better.tracking[1] < 0.2 * nominal.tracking[1]
    with open_store(store) as db:
        rows = db.sql(
            f"SELECT stage, value FROM errors WHERE source_id = '{id}' AND "
            "metric = 'rms_tracking_q' ORDER BY stage DESC, joint"
        )
        lineage = db.sql(f"SELECT parent, role FROM lineage WHERE child = '{id}'")
    assert rows["value"].to_pylist() == [*nominal.tracking, *better.tracking]
    kin = {tuple(r.values()) for r in lineage.to_pylist()}
    assert kin == {(run, "run"), (model, "model")}
    with again(store, find_record(store, id)) as (_, other):
        assert list(compare_records(find_record(store, id), other)) == []


def test_a_model_of_another_robot_is_refused(runs):
    store, *_ = runs
    other = replace(ROBOT, urdf=ROBOT.urdf + " ")
    model = kept(store, replace(corrected(), robot=other))
    with pytest.raises(InputError, match="as described then"):
        experiment.simulate_and_store(spec(model=model), store)


@pytest.mark.parametrize("paper", [False, True])
def test_tables_of_a_calibration_drive(runs, paper):
    store, _, run, _ = runs
    record = {"robot": ROBOT.name, "stage": "calibrated", "mode": "measured"}
    every, first = tables(), range(3)
    files = {"corrected.json": next(iter(to_json(tabulated()).files.values()))}
    if paper:  # they correct a simulated twin, so they are put on the nominal model
        record |= {"mode": "paper", "joints": [1, 2, 3]}
        record["request"] = {"robot_hash": ROBOT.content_hash}
        lookup = replace(
            every,
            joints=every.joints[:3],
            tables=(LookupTable((0,), every.tables[0].values[:, first]),),
            offset=every.offset[first],
            slope=every.slope[:, first],
        )
        files = build_lookup_files(lookup)
    id = commit_record(store, "models", record, files=files)
    _, validation = validate(Validate(run, 0.25, store, id))
    before, after = validation.models.values()
    # The spring is all that the nominal model lacks, and it is in the table.
    assert after.tracking[1] < 0.5 * before.tracking[1]
    if paper:
        other = replace(ROBOT, urdf=ROBOT.urdf + " ")
        with pytest.raises(InputError, match="as described then"):
            read_controller_model(store, id, other, nominal())
