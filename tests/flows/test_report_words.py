"""The verdict in plain sentences: claim, error, values that are off, alternatives."""

from dataclasses import replace

import pytest

from flows.report.phrases import format_effect_noun, format_effect_place, format_joints
from flows.report.sentences import (
    build_value_rows,
    describe_next_experiment,
    describe_unexplained,
    describe_wrong_values,
    format_brief_claim,
)
from flows.report.sentences import describe_alternative_sets as alternative_sets
from flows.report.sentences import format_headline as headline
from residual import quantity
from residual.check.result import Fault, LogCheck
from residual.effects import list_effect_parameters, load_effects
from residual.verdict.result import Place, Verdict
from tests.flows import report_outcomes as outcomes
from tests.flows.report_outcomes import given_value, parameter
from tests.verdict_documents import typed

SPRING, BALANCER, STRIBECK = (
    {"name": name, "joints": [joint]}
    for name, joint in (("spring", 2), ("balancer", 2), ("stribeck", 3))
)
ASYMMETRY = {"name": "coulomb_asymmetry", "joints": [4]}
LEVELS = {"nominal": 15.0, "identified": 9.6, "augmented": 7.1}


def verdict(*effects: dict, kind: str = "effects", **error: object) -> Verdict:
    return typed(outcomes.verdict(kind, list(effects), **error))


def effect(name: str, joints: list[int], **more: object) -> dict:
    return outcomes.effect(name, joints, {}, **more)


@pytest.mark.parametrize(
    ("effects", "start"),
    [
        ([effect("balancer", [2])], "The model lacks a balancer on joint 2."),
        (
            [
                effect("balancer", [2], equivalent=[SPRING]),
                effect("offset", [4], equivalent=[ASYMMETRY], order=2),
            ],
            "The model lacks a balancer on joint 2 (or a spring) and a constant torque "
            "offset on joint 4 (or Coulomb friction that differs by direction). "
            "These logs cannot separate the alternatives in brackets.",
        ),
        (
            [effect("spring", [1]), effect("coulomb", [3], order=2)],
            "The model lacks a spring on joint 1 and has a wrong value for Coulomb "
            "friction on joint 3.",
        ),
        (
            [effect("spring", [j], order=j) for j in range(1, 6)],
            "The model lacks a spring on joint 1, a spring on joint 2, a spring on "
            "joint 3 and two more.",
        ),
        (
            [effect("spring", [1], probability=0.7)],
            "The model most likely lacks a spring on joint 1.",
        ),
        (
            [effect("wind_load", [1], probability=None)],
            "The model lacks wind load on joint 1.",
        ),
    ],
)
def test_headline_says_what_is_missing(effects: list[dict], start: str) -> None:
    assert headline(verdict(*effects)).startswith(f"{start} Error on unseen motion: ")


def test_headline_of_nothing_says_which_values_only_the_refit_has() -> None:
    part = outcomes.verdict("none", [])
    fitted = "(refit). The refit also fitted viscous friction and rotor inertia, for "
    part["changes"] = [given_value("coulomb", 1, beyond=False)]
    assert f"{fitted}which the robot file has no values." in headline(typed(part))
    part["error"]["overall_moving"] = {"nominal": 2.0, "identified": 2.0}
    assert "also fitted" not in headline(typed(part))
    named = outcomes.verdict("effects", [effect("balancer", [2])])
    named["changes"] = part["changes"]
    assert "also fitted" not in headline(typed(named))


@pytest.mark.parametrize(
    ("levels", "steps"),
    [
        (LEVELS, "15.0 % (nominal) → 9.6 % (refit) → 7.1 % (with payload)"),
        # A refit that takes it all leaves no step that looks like none.
        (
            {"nominal": 12.8, "identified": 0.2, "augmented": 0.2},
            "12.8 % (nominal) → 0.2 % (with payload)",
        ),
        ({"identified": 8.0, "augmented": 9.0}, "8.0 % (refit) → 9.0 % (with payload)"),
    ],
)
def test_headline_gives_the_error_from_the_nominal_model_on(levels, steps) -> None:
    text = headline(verdict(effect("payload", [6]), overall_moving=levels))
    assert f"Error on unseen motion: {steps}." in text


def test_headline_admits_a_weak_test_what_is_left_and_what_got_worse() -> None:
    text = headline(verdict(effect("balancer", [2]), same_run=True, worse=[4]))
    assert "Error on unseen motion (end of the fitted run, a weak test): " in text
    assert text.endswith("The findings raise it on joint 4 (11.3 % → 11.4 %).")
    left = "No known effect explains the remaining error on joints 1, 4 and 6."
    assert headline(outcomes.one_effect().verdict).endswith(left)


def test_headline_of_nothing_and_of_unknown() -> None:
    level = "Error on unseen motion: 66.3 % (nominal) → 12.4 % (refit)."
    assert headline(outcomes.nothing().verdict) == f"No missing effect found. {level}"
    unknown = "The model lacks something on joints 1 and 4 that no known effect"
    assert headline(outcomes.unknown().verdict) == f"{unknown} explains. {level}"


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (
            "The model lacks a spring on joint 2, 15.0 → 7.1 %",
            {"effects": [effect("spring", [2])]},
        ),
        ("No missing effect found, 15.0 → 9.6 %", {"verdict": "none"}),
        ("No missing effect found", {"verdict": "none", "error": {}}),
    ],
)
def test_a_verdict_in_half_a_line(words, part) -> None:
    brief = typed({"error": {"overall_filtered": LEVELS}, **part})
    assert format_brief_claim(brief) == words


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        ({"nominal": 60.0, "identified": 55.0}, "does not describe these logs"),
        ({"nominal": 677.0, "identified": 9.0}, "does not describe these logs"),
        ({"nominal": 60.0, "identified": 9.0}, "No missing effect found."),
    ],
)
def test_nothing_named_is_not_always_nothing_missing(levels, words) -> None:
    nothing = replace(outcomes.nothing().verdict, log_check=None)
    error = replace(nothing.error, overall_moving=levels)
    assert words in headline(replace(nothing, error=error))


def test_a_suspected_fault_comes_before_the_effects() -> None:
    fault = Fault("torque_sign", (2,), False, "it drives", repair="sign = -1")
    report = LogCheck((fault,))
    text = headline(replace(outcomes.nothing().verdict, log_check=report))
    assert text.startswith("No missing effect found, but the logs may be faulty: ")


@pytest.mark.parametrize(
    ("joints", "dof", "words"),
    [
        ([], 6, ""),
        ([1, 3, 4, 5, 7], 7, "joints 1, 3 to 5 and 7"),
        ([1, 2, 3, 4, 5, 6], 6, "all six joints"),
        ([1, 2, 3, 4, 5, 6], None, "joints 1 to 6"),
        ([1, 2], 2, "both joints"),
    ],
)
def test_joints_in_words(joints: list[int], dof: int | None, words: str) -> None:
    assert format_joints(joints, dof) == words


@pytest.mark.parametrize("name", list_effect_parameters())
def test_every_effect_has_words_of_its_own(name: str) -> None:
    effect = load_effects()[name]
    assert effect.sentence[0].islower()
    for words in (format_effect_noun(name), effect.noun, effect.sentence):
        assert words
        assert "_" not in words
        assert not words.startswith("The")
        assert not words.endswith(".")
    others = [format_effect_noun(n) for n in list_effect_parameters() if n != name]
    assert format_effect_noun(name) not in others
    assert format_effect_place(Place(name, (2,))).startswith(format_effect_noun(name))


@pytest.mark.parametrize(
    ("name", "joints", "words"),
    [
        ("spring", [2], "a spring on joint 2"),
        ("coulomb", [1, 2, 3], "Coulomb friction on all three joints"),
        ("coupled_friction", [2, 3], "coupled friction between joints 2 and 3"),
        ("payload", [3], "a payload at the flange"),
        ("x_hose", [1], "x hose on joint 1"),
        (None, [1], "an effect without a name on joint 1"),
    ],
)
def test_an_effect_stands_where_its_file_puts_it(name, joints, words):
    assert format_effect_place(Place(name, tuple(joints)), dof=3) == words


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (6983.2, 41.7, "N m", "6983 ± 42 N m"),
        (-0.0532, 0.0021, "rad", "-0.0532 ± 0.0021 rad"),
        (1.2e-7, 3e-8, "kg m^2", "(1.20 ± 0.30)e-7 kg m²"),
        (3.14159, None, "N m s^2/rad^2", "3.14 N m s²/rad²"),
        (0.0, 0.5, "-", "0.00 ± 0.50"),
        (float("nan"), 0.1, "kg", "–"),
        (True, None, "kg", "–"),
    ],
)
def test_values_are_cut_at_what_is_known(value, std, unit, text):
    assert quantity.format_uncertain_value(value, std, unit) == text


def test_what_the_residual_depends_on_is_said_joint_by_joint() -> None:
    entry = {"joint": 4, "of": [], "form": "curve", "share": 0.97, "frequency": None}
    rest = {
        "joints": [2, 4, 5],
        "depends_on": [
            entry | {"on": "frequency", "frequency": 5.4634},
            entry | {"joint": 5, "on": "q", "of": [5, 6], "form": "difference"},
            entry | {"joint": 5, "on": "t", "form": "by direction", "share": 0.2},
        ],
    }
    text = " ".join(describe_unexplained(typed({"unexplained": rest})))
    assert "Of the residual on joint 4, 97.0 % oscillates at 5.46 Hz." in text
    assert "joint 5, 97.0 % follows q5 - q6 and 20.0 % drifts with time, by d" in text
    assert "The residual on joint 2 depends on no known variable." in text


def record(*effects: dict, **part: object) -> Verdict:
    declared = ("viscous", "coulomb", "rotor_inertia")
    return typed({"declared": declared, "effects": list(effects), **part})


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ([], ""),
        ([given_value("coulomb", 1, beyond=False)], ""),
        ([given_value("coulomb", 1, explained=True)], ""),
        (
            [given_value("coulomb", 1)],
            "One nominal value disagrees with the logs: coulomb level of joint 1 (4 → "
            "4.6 N m).",
        ),
        (
            [given_value("inertial", 3), given_value("coulomb", 2)],
            "Two nominal values disagree with the logs: coulomb level of joint 2 (4 → "
            "4.6 N m) and one combination of masses and inertias.",
        ),
    ],
)
def test_values_that_are_off_are_counted_and_named(changes, sentence) -> None:
    assert describe_wrong_values(record(changes=changes)) == sentence


@pytest.mark.parametrize(
    ("change", "cells"),
    [
        (
            given_value("rotor_inertia", 2),
            ("rotor inertia of joint 2", "4 N m", "+15 %"),
        ),
        (
            given_value("viscous", 3, 0.0, 1.0),
            ("viscous coefficient of joint 3", "0 N m", ""),
        ),
        (
            given_value("inertial", 2, -4.0, -5.0, parameter="m3 + m4 + m5"),
            ("m3 + m4 + ...", "-4 N m", "-25 %"),
        ),
    ],
)
def test_a_row_has_name_nominal_value_and_difference(change, cells) -> None:
    one = record(changes=[change])
    ((name, nominal, _, difference),) = build_value_rows(one.changes, one)
    assert (name, nominal, difference) == cells


def another(*places: dict, by: str = "motion") -> dict:
    return {"set": list(places), "nats": -2.0, "separated_by": by}


def test_other_sets_are_said_one_by_one() -> None:
    spring, pair = effect("spring", [2]), "a balancer on joint 2 and Stribeck friction"
    lines = alternative_sets(record(spring, alternatives=[another(BALANCER, STRIBECK)]))
    assert lines == [
        f"Equally well supported: {pair} on joint 3.",
        "Another motion would separate them.",
    ]
    lines = alternative_sets(record(spring, alternatives=[another(by="nothing")]))
    nothing = "Equally well supported: no effect at all."
    assert lines == [nothing, "No motion would separate them."]


def test_a_set_that_an_equivalent_says_already_is_not_said_again() -> None:
    finding = effect("spring", [2], equivalent=[BALANCER])
    assert alternative_sets(record(finding, alternatives=[another(BALANCER)])) == []
    level = {"level": parameter([1, 2], [0, 0], "N m")}
    several = outcomes.effect("coulomb", [1, 2], level)
    swap = another(*({"name": "coulomb", "joints": [j]} for j in (1, 2)), SPRING)
    balancer = effect("balancer", [2], equivalent=[SPRING])
    assert alternative_sets(record(several, balancer, alternatives=[swap])) == []


@pytest.mark.parametrize(
    ("finding", "other", "words"),
    [
        ("link_inertia", "payload", "No motion separates them: weigh the load"),
        ("balancer", "spring", "modelgap next looks for a motion"),
    ],
)
def test_a_load_and_its_link_are_told_apart_by_scales(finding, other, words) -> None:
    named = effect(finding, [6], equivalent=[{"name": other, "joints": [6]}])
    (sentence,) = describe_next_experiment(verdict(named))
    assert sentence.startswith(words)
