"""The verdict's form: every key in every kind of verdict, and plain numbers."""

import json
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from residual.check.result import Fault, LogCheck
from residual.diagnosis.diagnose import diagnose
from residual.effects import list_effect_parameters, load_effects
from residual.errors import InputError
from residual.verdict.document import from_json, to_json
from residual.verdict.result import Verdict
from sim.engine.plant_records import SyntheticEffect as Effect
from tests.residual.arms import arm, diagnose_case, names, plain_logs, short_case
from tests.test_schemas import validate

OFFSET = Effect("offset", (1,), {"torque": 4.0})
CHURN = Effect("quadratic_viscous", (2,), {"coefficient": 1.5})
KNOCK = Effect("x_square_wave", (2,), {"amplitude": 1.5, "frequency": 0.4})
GROWN = Effect("coulomb", (2,), {"level": 3.0})
LOAD = Effect("payload", (2,), {"mass": 1.5, "com_x": 0.1, "com_y": 0, "com_z": 0.05})
# On two links a load can be imitated by the last one: it takes a robot that is known.
SURE = "[prior]\nscale = 0.03\n"
DEAD = "joint 2 stands"
MUTE = "joint 2 logs no torque"


def half_dead(moving, silent=()):
    logs = plain_logs(arm(), moving, [2.0, 0.0], count=5)
    for j in silent:
        logs = [replace(r, tau=r.tau * (np.arange(2) != j)) for r in logs]
    return diagnose(arm(), logs[:4], held_out=logs[4:])


def two_effects():
    return short_case(arm(), OFFSET, CHURN, seed=51, duration=6.0)


MAKE = {
    "none": lambda: diagnose_case(short_case(arm(), seed=50)),
    "effects": lambda: diagnose_case(two_effects()),
    "several joints": lambda: diagnose_case(short_case(arm(), seed=52), ["viscous"]),
    "unknown": lambda: diagnose_case(short_case(arm(), KNOCK, seed=53, duration=10.0)),
    "baseline": lambda: diagnose_case(short_case(arm(), GROWN, seed=54)),
    "payload": lambda: diagnose_case(short_case(arm(toml=SURE), LOAD, seed=55)),
    "same run": lambda: diagnose_case(
        short_case(arm(), OFFSET, seed=51, duration=6.0), held_out=()
    ),
    DEAD: lambda: half_dead(moving=[0]),
    MUTE: lambda: half_dead(moving=[0, 1], silent=[1]),
}
KINDS = sorted(MAKE)


@cache
def outcome_of(kind):
    return MAKE[kind]()


def document(kind):
    return to_json(outcome_of(kind).verdict)


TABLES = ("held_out", "filtered", "moving")
TABLES += ("overall", "overall_filtered", "overall_moving")
NO_EFFECTS = {"none": "none", "unknown": "unknown"}


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_is_there_and_no_other(kind):
    """By the schema, which refuses another key; tests/contract holds the keys."""
    verdict = document(kind)
    validate("verdict", verdict)
    assert verdict["verdict"] == NO_EFFECTS.get(kind, "effects")
    for entry in verdict["unexplained"]["depends_on"]:
        assert entry["joint"] in verdict["unexplained"]["joints"]


@pytest.mark.parametrize("kind", KINDS)
def test_it_goes_through_json_without_a_nan_and_is_read_back_as_it_was(kind):
    verdict = outcome_of(kind).verdict
    text = json.dumps(to_json(verdict), allow_nan=False)
    assert json.loads(text) == to_json(verdict)
    assert from_json(json.loads(text)) == verdict
    assert json.dumps(to_json(from_json(json.loads(text)))) == text


LATER = {"suspected", "too_small"}  # a record without them is an older one


@pytest.mark.parametrize("key", sorted(LATER))
def test_a_verdict_that_is_older_than_a_key_has_nothing_there(key):
    record = document("effects")
    del record[key]
    assert getattr(from_json(record), key) == ()


@pytest.mark.parametrize(
    "key", sorted({"schema", *(each.name for each in fields(Verdict))} - LATER)
)
def test_a_verdict_that_lacks_a_key_is_refused(key):
    record = document("effects")
    del record[key]
    with pytest.raises(InputError):
        from_json(record)


FAULT = Fault("torque_sign", (2,), True, "Friction gives.", repair=("tau = {}",))
DOUBT = Fault("filtered", (), False, "No noise.")


def checked(check, baseline=()):
    """The diagnosis of logs with a constant torque, in which a check found faults."""
    logs = plain_logs(arm(), [0, 1], [2.0, 0.0], count=5)
    return diagnose(arm(), logs[:4], baseline, logs[4:], check=check)


@pytest.mark.parametrize("compared", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_trusted_fault_of_the_logs_is_a_warning_and_the_names_stand(compared):
    baseline = plain_logs(arm(), [0, 1], 0.0) if compared else ()
    result = checked(LogCheck((FAULT, DOUBT)), baseline)
    after, same = to_json(result.verdict), to_json(checked(None, baseline).verdict)
    assert after["effects"]
    assert "(faulty logs)" in repr(result)
    assert from_json(json.loads(json.dumps(after, allow_nan=False))) == result.verdict
    assert after.pop("log_check")["verdict"] == "unusable"
    warnings, rest = after.pop("warnings"), same.pop("warnings")
    assert warnings == [FAULT.sentence, DOUBT.sentence, *rest]
    assert warnings[0] == (
        "fault of the logs (torque sign, joint 2, certain): Friction gives. Fix: tau = {}"
    )
    assert {**after, "log_check": None} == same


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_have_an_entry_per_joint_and_joints_are_numbered_from_one(kind):
    verdict = document(kind)
    dof = 2
    for table in ("held_out", "filtered", "moving"):
        for stage in ("nominal", "identified", "augmented"):
            assert len(verdict["error"][table][stage]) == dof
        corrected = verdict["error"][table]["plsr"]
        if verdict["unexplained"]["joints"]:
            assert len(corrected) == dof
        else:
            assert corrected is None
    assert len(verdict["unexplained"]["per_joint"]) == dof
    for effect in verdict["effects"]:
        for p in effect["parameters"].values():
            if isinstance(p["value"], list):
                assert len(p["value"]) == len(p["std"]) == len(effect["joints"])
            else:
                assert not isinstance(p["std"], list)
    joints_named = [e["joints"] for e in verdict["effects"]]
    joints_named += [q["joints"] for e in verdict["effects"] for q in e["equivalent"]]
    joints_named += [m["joints"] for m in verdict["minimum_detectable"]]
    joints_named.append(verdict["unexplained"]["joints"])
    for joints in joints_named:
        assert all(1 <= j <= dof for j in joints)
    local = {n for n, e in load_effects().items() if e.scope == "local"}
    last = {m["joints"][0] for m in verdict["minimum_detectable"] if m["name"] in local}
    # What joint 2 lacks cannot be seen where it stands or logs no torque.
    assert max(last) == (1 if kind in (DEAD, MUTE) else dof)


@pytest.mark.parametrize("kind", KINDS)
def test_a_finding_says_who_it_is_how_sure_and_how_large(kind):
    for i, effect in enumerate(document(kind)["effects"], start=1):
        assert effect["order"] == i
        assert 0.5 < effect["probability"] <= 1
        assert {"name": effect["name"], "joints": effect["joints"]} not in effect["equivalent"]
        for key, parameter in effect["parameters"].items():
            assert list_effect_parameters()[effect["name"]][key] == parameter["unit"]
            assert np.all(np.asarray(parameter["std"]) >= 0)
        evidence = effect["evidence"]
        assert evidence["by"] in ("fit", "plausibility")
        assert evidence["held_out"] in ("confirmed", "neutral")
        assert evidence["held_out_gain"] >= 0
        assert evidence["p_value"] is None
        assert evidence["nats"] > 0


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_no_relative_error_is_given_for_a_torque_that_is_zero_or_never_moves():
    for table in ("held_out", "filtered", "moving"):
        assert document(MUTE)["error"][table]["nominal"][1] is None
    assert document(DEAD)["error"]["moving"]["nominal"][1] is None
    # Joint 1 has 2 N m too much in either case: a mute joint 2 does not spoil that.
    mute, dead = (document(kind) for kind in (MUTE, DEAD))
    assert 1 not in mute["unexplained"]["joints"]
    assert ("offset", (1,)) in names(from_json(mute))
    assert names(from_json(dead)) == [("offset", (1,))]


def tried(verdict):
    return {entry["name"] for entry in verdict["minimum_detectable"]}


def test_warmup_is_no_candidate_where_the_order_of_the_logs_is_unknown():
    """Every log starts at 0, as most controllers write them."""
    case = short_case(arm(), seed=50)
    reset = [replace(r, t=r.t - r.t[0]) for r in (*case.fit, *case.held_out)]
    outcome = diagnose_case(case, fit=reset[:-1], held_out=reset[-1:])
    assert "warmup" not in tried(to_json(outcome.verdict))
    assert any("order of the logs in time is not known" in n for n in outcome.notes)
    assert "warmup" in tried(document("none"))
    assert not any("order of the logs" in n for n in outcome_of("none").notes)


def test_the_same_input_gives_the_same_verdict_and_progress_runs_to_the_proof():
    progress = []
    again = diagnose_case(two_effects(), progress=lambda *x: progress.append(x))
    assert json.dumps(to_json(again.verdict)) == json.dumps(document("effects"))
    assert list(dict(progress)) == ["search", "proof"]
    assert all(0 <= share <= 1 for _, share in progress)
    assert progress[-1] == ("proof", 1.0)


def test_the_order_of_the_logs_does_not_change_what_is_found():
    case = two_effects()
    other = to_json(diagnose_case(case, fit=case.fit[::-1]).verdict)
    first = document("effects")
    assert {n for n, _ in names(from_json(other))} == {n for n, _ in names(from_json(first))}
    np.testing.assert_allclose(
        other["unexplained"]["per_joint"], first["unexplained"]["per_joint"], atol=1e-4
    )


def test_the_held_out_log_never_changes_what_is_fitted():
    """Another torque there changes the errors, and nothing that the fit logs say."""
    case = two_effects()
    rng = np.random.default_rng(0)
    (held_out,) = case.held_out
    noise = rng.normal(size=held_out.tau.shape)
    tau = 1.01 * held_out.tau + 0.1 * held_out.tau.std(axis=0) * noise
    changed = diagnose_case(case, held_out=[replace(held_out, tau=tau)])
    one, two = outcome_of("effects"), changed
    assert names(one.verdict) == names(two.verdict)
    for a, b in zip(to_json(one.verdict)["effects"], to_json(two.verdict)["effects"], strict=True):
        assert a["parameters"] == b["parameters"]
        assert a["evidence"]["nats"] == b["evidence"]["nats"]
        assert a["equivalent"] == b["equivalent"]
    for key in ("minimum_detectable", "unexplained", "nominal_scale"):
        assert to_json(one.verdict)[key] == to_json(two.verdict)[key]
    for proofs in zip(one.proofs, two.proofs, strict=True):
        for stage in ("nominal", "identified", "augmented"):
            np.testing.assert_array_equal(*(p.tau_hat[stage] for p in proofs))
    errors = [to_json(o.verdict)["error"]["held_out"]["identified"] for o in (one, two)]
    assert np.abs(np.subtract(*errors)).min() > 0.1


def test_white_noise_in_place_of_torque_has_no_name():
    rng = np.random.default_rng(3)
    case = short_case(arm(), seed=59)
    logs = (*case.fit, *case.held_out)
    noise = [replace(r, tau=20 * rng.normal(size=r.tau.shape)) for r in logs]
    verdict = to_json(diagnose_case(case, fit=noise[:-1], held_out=noise[-1:]).verdict)
    assert verdict["effects"] == []


def test_what_knocks_with_time_is_told_with_its_frequency_and_left_uncorrected():
    """A square wave of 0.4 Hz on joint 2: no table of the state can help."""
    outcome = outcome_of("unknown")
    verdict = to_json(outcome.verdict)
    assert verdict["unexplained"]["kind"] == "time-driven"
    (dependence,) = verdict["unexplained"]["depends_on"]
    got = [dependence[k] for k in ("joint", "on", "of")]
    assert got == [2, "frequency", []]
    assert dependence["frequency"] == pytest.approx(0.4, abs=0.06)
    assert any("joint 2: not correctable from state" in w for w in verdict["warnings"])
    for table in TABLES:
        assert verdict["error"][table]["plsr"] == verdict["error"][table]["augmented"]
    (cloud,) = outcome.residual_clouds
    assert (cloud.joint, cloud.name) == (2, "")
    shapes = {x.shape for x in (cloud.x, cloud.residual, cloud.fitted, cloud.log)}
    assert len(shapes) == 1


def test_a_change_against_a_baseline_is_found_and_proved():
    """Coulomb friction that was there already grew by a known amount on joint 2."""
    verdict = outcome_of("baseline").verdict
    assert names(verdict) == [("coulomb", (2,))]
    (effect,) = verdict.effects
    level = effect.parameters["level"]
    assert level.value == pytest.approx(3.0, abs=4 * level.std + 0.1)
    assert effect.evidence.held_out == "confirmed"
    moving = verdict.error.moving
    assert moving["augmented"][1] < 0.6 * moving["nominal"][1]
    # As good as the new logs' own fit, of which nobody can say what changed.
    assert moving["augmented"][1] < moving["identified"][1] + 1
