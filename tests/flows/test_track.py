"""Corrected control: an arm driven by any model, and what a wrong one does to it."""

from dataclasses import replace

import numpy as np
import pytest

from flows.cli import main
from flows.report import experiments
from flows.specs.experiment import experiment_of
from flows.steps import experiment
from flows.steps import rerun as reruns
from flows.steps.experiment import settled, torque_of
from flows.steps.track import LOOP, MODEL, NOMINAL, Motion, Track, track, tracked
from residual.effects import registry
from residual.errors import InputError
from residual.model.control import WIDTH, Use, computed_torque, feed_forward
from residual.model.model import Model, Term
from residual.model.record import to_record
from residual.robot.dynamics import inertial_parameters
from residual.robot.robot import load_robot
from sim.engine.records import Noise, PlantEffect, PlantSpec, TrajectorySpec
from sim.plant.controller import maker_of
from sim.trajectories import make_reference
from warehouse.commit import commit_record
from warehouse.layout import read_record
from warehouse.query.store import open_store
from warehouse.runs import read_manifest

ROBOT = load_robot("irb140")
SPRING = PlantEffect("spring", (2,), (("stiffness", 60.0),))
QUIET = PlantSpec((SPRING,), 0.0, Noise(0.0, 1e-5), seed=3)


def term(name, joint, *values):
    effect = registry()[name]
    theta, shape = effect.from_values(np.array(values), ROBOT)
    return Term(effect, (joint - 1,), tuple(shape), np.asarray(theta, float))


def nominal():
    """What the maker knows of the arm: body, friction and rotors."""
    known = dict(
        zip(("coulomb", "viscous", "rotor_inertia"), maker_of(ROBOT), strict=True)
    )
    terms = [
        term(k, j + 1, v) for k, values in known.items() for j, v in enumerate(values)
    ]
    return Model(ROBOT, inertial_parameters(ROBOT.model), tuple(terms))


def corrected(joint=2, stiffness=60.0):
    model = nominal()
    return replace(model, terms=(*model.terms, term("spring", joint, stiffness, 0.0)))


@pytest.fixture(scope="module")
def motions(compiled_plant):
    made = []
    for kind, seed in (("cyclic", 1), ("welding", 2)):
        reference = make_reference(ROBOT, TrajectorySpec(kind, 4.0, 1, seed), 1000.0)
        made.append(Motion(reference, QUIET, None))
    return made


@pytest.fixture(scope="module")
def driven(motions):
    return tracked(ROBOT, {NOMINAL: nominal(), MODEL: corrected()}, motions)


def parts(motion):
    reference = motion.reference
    return reference.t, (reference.q, reference.qd, reference.qdd)


def test_the_right_model_tracks_better_fed_forward_and_in_the_loop(driven):
    for loop in ("", LOOP):
        assert driven.gain(NOMINAL + loop, MODEL + loop).ratio < 0.7
        without, with_it = (
            driven.values(cell + loop, "rms")[:, 1] for cell in (NOMINAL, MODEL)
        )
        assert (with_it < 0.2 * without).all()


def test_effects_and_acceleration_each_earn_their_place(driven):
    for left_out in (", no effects", ", no acceleration"):
        assert driven.gain(f"{MODEL}{left_out}", MODEL).ratio < 0.7
    assert driven.gain(f"{NOMINAL}, neither", f"{MODEL}, neither").ratio == 1.0


@pytest.mark.parametrize(("joint", "stiffness"), [(2, -60.0), (3, 60.0), (2, 180.0)])
def test_a_wrong_correction_makes_it_worse(motions, driven, joint, stiffness):
    wrong = tracked(ROBOT, {MODEL: corrected(joint, stiffness)}, motions[:1])
    good = driven.values(NOMINAL, "rms")[0]
    assert np.linalg.norm(wrong.values(MODEL, "rms")) > 1.3 * np.linalg.norm(good)


def test_twice_the_correction_gains_next_to_nothing(motions, driven):
    wrong = tracked(ROBOT, {MODEL: corrected(2, 120.0)}, motions[:1])
    right, none = (driven.values(cell, "rms")[0] for cell in (MODEL, NOMINAL))
    twice = np.linalg.norm(wrong.values(MODEL, "rms"))
    assert twice > 4 * np.linalg.norm(right)
    assert twice > 0.9 * np.linalg.norm(none)


def test_differences_are_taken_in_pairs_with_an_interval(driven):
    gain = driven.gain(NOMINAL, MODEL)
    assert gain.n == 2
    assert gain.low < gain.change < gain.high
    change = [
        np.linalg.norm(b) - np.linalg.norm(a)
        for a, b in zip(
            *(driven.values(c, "rms") for c in (NOMINAL, MODEL)), strict=True
        )
    ]
    # Student's t of one degree of freedom: 12.706.
    half = 12.706 * np.std(change, ddof=1) / np.sqrt(2)
    assert gain.high - gain.change == pytest.approx(half, rel=1e-4)


def test_computed_torque_on_the_reference_is_the_feed_forward(motions):
    t, motion = parts(motions[0])
    law = computed_torque(corrected(), t, motion, Use())
    along = feed_forward(corrected(), t, motion, Use())
    for k in (0, 1234, 3999):
        q, qd, qdd = (x[k] for x in motion)
        np.testing.assert_allclose(law(k, q, qd, qdd), along[k], atol=1e-9)
        bare = computed_torque(corrected(), t, motion, Use(acceleration=False))
        still = feed_forward(corrected(), t, motion, Use(acceleration=False))
        np.testing.assert_allclose(bare(k, q, qd, qdd), still[k], atol=1e-9)


def test_friction_turns_over_a_width_that_does_not_chatter(motions):
    t, (q, _, _) = parts(motions[0])
    slow = np.linspace(-3 * WIDTH, 3 * WIDTH, len(t))[:, None] * np.ones(6)
    still = np.broadcast_to(q[:1], q.shape), slow, np.zeros_like(q)
    body = replace(nominal(), terms=())
    friction = feed_forward(nominal(), t, still, Use())
    friction = friction - feed_forward(body, t, still, Use())
    level, viscous, _ = maker_of(ROBOT)
    wanted = level * np.tanh(slow / WIDTH) + viscous * slow
    np.testing.assert_allclose(friction, wanted, atol=1e-9)


def kept(store, model):
    record = {"robot": ROBOT.name, "stage": "augmented", "model": to_record(model)}
    return commit_record(store, "models", record)


def spec(**controller):
    return experiment_of(
        {
            "trajectory": {"kind": "cyclic", "duration": 4.0, "periods": 1},
            "plant": {
                "scatter": 0.0,
                "effect": [{"name": "spring", "joints": [2], "stiffness": 60.0}],
                "noise": {"torque": 0.0},
            },
            **({"controller": controller} if controller else {}),
        },
        "SPEC.toml",
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory, compiled_plant):
    """A store, a model in it, a run by the nominal one and a run by that model."""
    store = tmp_path_factory.mktemp("store")
    model = kept(store, corrected())
    by_nominal = experiment.run(spec(), store)
    return store, model, by_nominal, experiment.run(spec(model=model[:7]), store)


def test_a_spec_names_the_model_that_drives_and_the_run_keeps_its_whole_id(runs):
    store, model, by_nominal, by_model = runs
    half = read_manifest(store, by_model)["spec"]["controller"]
    assert half == {"kind": "computed_torque", "model": model}
    assert "controller" not in read_manifest(store, by_nominal)["spec"]
    with open_store(store) as opened:
        query = f"SELECT parent, role FROM lineage WHERE child = '{by_model}'"
        assert opened.sql(query).to_pylist() == [
            {"parent": model, "role": "controller"}
        ]
    # The same spec is the same run, however the model is named.
    assert experiment.run(spec(model=model), store) == by_model
    other = experiment.run(spec(model=model, kind="feed_forward"), store)
    assert other not in (by_model, by_nominal)


def test_where_none_is_adopted_the_adopted_model_is_the_nominal_one(
    runs,
):
    store, *_ = runs
    assert settled(spec(model="adopted"), ROBOT, store) == spec(model="nominal")


def test_a_rerun_is_driven_by_the_model_of_then(runs):
    store, _, _, by_model = runs
    made = reruns.rerun(by_model, store, True)
    assert (list(made.apart), made.cause) == ([], None)


def test_the_command_drives_keeps_and_tells(runs, capsys):
    store, model, run, _ = runs
    words = ["validate", run[:8], "--model", model[:8], "--store", str(store)]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert f"model: {model[:8]}" in told.splitlines()[0]
    assert float(told.split("rms, model for nominal: ")[1].split()[0]) < 0.9
    id = told.split("modelgap show ")[-1].split()[0]
    record = read_record(store, id)
    assert (record["kind"], record["model_id"]) == ("tracking", model)
    with open_store(store) as opened:
        query = (
            f"SELECT DISTINCT metric FROM errors WHERE source_id = '{id}' ORDER BY 1"
        )
        assert opened.sql(query).column(0).to_pylist() == [
            "chatter_tau",
            "energy",
            "peak_tracking_q",
            "rms_tracking_q",
        ]
    assert track(Track((run,), model, 0, store))[0] == id
    *_, gain = experiments.tracking(track(Track((run,), model, 0, store))[1])
    assert "single motion" in gain


def test_a_model_of_another_robot_is_refused(runs, tmp_path):
    store, *_ = runs
    other = replace(ROBOT, urdf=ROBOT.urdf + " ")
    model = kept(store, replace(corrected(), robot=other))
    with pytest.raises(InputError, match="as it was described then"):
        experiment.run(spec(model=model), store)


def test_every_kind_of_drive_gives_what_the_controller_takes(motions):
    reference = motions[0].reference
    given = torque_of(corrected(), reference, "feed_forward", Use())
    assert given.shape == reference.q.shape
    assert callable(torque_of(corrected(), reference, "computed_torque", Use()))
