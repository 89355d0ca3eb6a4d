"""The verdict in plain sentences: claim, error, values that are off, alternatives."""

from dataclasses import replace

import pytest

from flows.report.phrases import format_effect_noun, format_effect_place
from flows.report.sentences import describe_alternative_sets as alternative_sets
from flows.report.sentences import describe_next_experiment
from flows.report.sentences import format_headline as headline
from residual import quantity
from residual.check.result import Fault, LogCheck
from residual.effects import list_effect_parameters, load_effects
from residual.verdict.result import Place, Verdict
from tests.flows import report_outcomes as outcomes
from tests.flows.report_outcomes import parameter
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
            [effect("spring", [j], order=j) for j in range(1, 6)],
            "The model lacks a spring on joint 1, a spring on joint 2, a spring on "
            "joint 3 and two more.",
        ),
        (
            [effect("spring", [1], probability=0.7)],
            "The model most likely lacks a spring on joint 1.",
        ),
    ],
)
def test_headline_says_what_is_missing(effects: list[dict], start: str) -> None:
    assert headline(verdict(*effects)).startswith(f"{start} Error on unseen motion: ")


def test_headline_gives_the_error_from_the_nominal_model_on() -> None:
    text = headline(verdict(effect("payload", [6]), overall_moving=LEVELS))
    steps = "15.0 % (nominal) → 9.6 % (refit) → 7.1 % (with payload)"
    assert f"Error on unseen motion: {steps}." in text
    # A refit that takes it all leaves no step that looks like none.
    levels = {"nominal": 12.8, "identified": 0.2, "augmented": 0.2}
    text = headline(verdict(effect("payload", [6]), overall_moving=levels))
    assert "12.8 % (nominal) → 0.2 % (with payload)" in text


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


def record(*effects: dict, **part: object) -> Verdict:
    declared = ("viscous", "coulomb", "rotor_inertia")
    return typed({"declared": declared, "effects": list(effects), **part})


def another(*places: dict, by: str = "motion") -> dict:
    return {"set": list(places), "nats": -2.0, "separated_by": by}


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
