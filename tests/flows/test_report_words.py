"""The verdict in plain sentences, and numbers as people write them."""

from dataclasses import replace

import pytest

from flows.report.words.outlook import (
    unexplained_words,
)
from flows.report.words.phrases import joint_words, noun, phrase
from flows.report.words.verdict import headline
from residual import quantity
from residual.check.result import Fault, LogCheck
from residual.diagnosis.result import Place, Verdict
from residual.effects import registry, vocabulary
from tests.flows import report_outcomes as made
from tests.verdict_documents import typed

SPRING = {"name": "spring", "joints": [2]}
ASYMMETRY = {"name": "coulomb_asymmetry", "joints": [4]}
CANNOT = "these data cannot tell"


def verdict(*effects: dict, kind: str = "effects", **error: object) -> Verdict:
    return typed(made.verdict(kind, list(effects), **error))


def effect(name: str, joints: list[int], **more: object) -> dict:
    return made.effect(name, joints, {}, **more)


@pytest.mark.parametrize(
    ("effects", "start"),
    [
        ([effect("balancer", [2])], "The model lacks a balancer on joint 2."),
        (
            [effect("balancer", [2], equivalent=[SPRING])],
            f"The model lacks a balancer on joint 2 (or a spring: {CANNOT}).",
        ),
        (
            [
                effect("balancer", [2], equivalent=[SPRING]),
                effect("offset", [4], equivalent=[ASYMMETRY], order=2),
            ],
            "The model lacks a balancer on joint 2 (or a spring) and a constant torque "
            "offset on joint 4 (or Coulomb friction that differs by direction). "
            "These data cannot tell a name in brackets from the one before it.",
        ),
        (
            [effect("ripple", [4, 5, 6], order=2), effect("spring", [1])],
            "The model lacks a spring on joint 1 and torque ripple on joints 4 to 6.",
        ),
        (
            [effect("coulomb", [1]), effect("viscous", [2], order=2)],
            "The model has wrong values for Coulomb friction on joint 1 and viscous "
            "friction on joint 2.",
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
    assert headline(verdict(*effects)).startswith(start + " ")


def test_headline_proves_all_joints_on_their_moving_samples() -> None:
    end = "Held-out error over all joints, while they move, falls from 12.4 % to 7.9 %."
    assert headline(verdict(effect("balancer", [2]))).endswith(end)


def test_headline_does_not_call_a_rise_a_fall() -> None:
    worse = {"identified": 8.0, "augmented": 9.0}
    text = headline(verdict(effect("payload", [6]), overall_moving=worse))
    assert "while they move, rises from 8.0 % to 9.0 %." in text
    same = {"identified": 8.0, "augmented": 8.01}
    text = headline(verdict(effect("payload", [6]), overall_moving=same))
    assert "while they move, stays at 8.0 %." in text


def test_headline_calls_the_same_run_a_weak_proof_and_admits_what_is_left() -> None:
    text = headline(verdict(effect("balancer", [2]), same_run=True))
    assert text.endswith("to 7.9 % in the same run: a weak proof.")
    left = "Joints 1, 4 and 6 keep an error that no known effect explains."
    assert headline(made.one_effect().verdict).endswith(left)


def test_headline_of_nothing_and_of_unknown() -> None:
    level = "Its held-out error is 12.4 % over all joints, while they move."
    nothing = f"No effect that the model lacks shows in these data. {level}"
    assert headline(made.nothing().verdict) == nothing
    unknown = "The model lacks something on joints 1 and 4 that no known effect"
    assert headline(made.unknown().verdict) == f"{unknown} explains. {level}"


@pytest.mark.parametrize(
    ("joints", "dof", "words"),
    [
        ([], 6, ""),
        ([2, 1], 6, "joints 1 and 2"),
        ([4, 5, 6], 6, "joints 4 to 6"),
        ([1, 3, 4, 5, 7], 7, "joints 1, 3 to 5 and 7"),
        ([1, 2, 3, 4, 5, 6], 6, "all six joints"),
        ([1, 2, 3, 4, 5, 6], None, "joints 1 to 6"),
        ([1, 2], 2, "both joints"),
        ([1], 1, "joint 1"),
    ],
)
def test_joints_in_words(joints: list[int], dof: int | None, words: str) -> None:
    assert joint_words(joints, dof) == words


@pytest.mark.parametrize("name", vocabulary())
def test_every_effect_has_words_of_its_own(name: str) -> None:
    effect = registry()[name]
    assert effect.sentence[0].islower()
    for words in (noun(name), effect.noun, effect.sentence):
        assert words
        assert "_" not in words
        assert not words.startswith("The")
        assert not words.endswith(".")
    others = [noun(other) for other in vocabulary() if other != name]
    assert noun(name) not in others
    assert phrase(Place(name, (2,))).startswith(noun(name))


@pytest.mark.parametrize(
    ("name", "joints", "words"),
    [
        ("spring", [2], "a spring on joint 2"),
        ("coulomb", [1, 2, 3], "Coulomb friction on all three joints"),
        ("link_inertia", [3], "the inertia of link 3"),
        ("link_inertia", [1, 2, 3], "the inertia of all three links"),
        ("coupled_friction", [2, 3], "coupled friction between joints 2 and 3"),
        ("payload", [3], "a payload at the flange"),
        ("base_tilt", [], "a tilted base"),
        ("x_hose", [1], "x hose on joint 1"),
        (None, [1], "an effect without a name on joint 1"),
    ],
)
def test_an_effect_stands_where_its_file_puts_it(
    name: str | None, joints: list[int], words: str
) -> None:
    assert phrase(Place(name, tuple(joints)), dof=3) == words


def test_a_headline_names_the_joint_that_got_worse() -> None:
    text = headline(verdict(effect("payload", [6]), worse=[4]))
    assert "It rises on joint 4 from 11.3 % to 11.4 %." in text


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        ({"nominal": 60.0, "identified": 55.0}, "does not describe these logs"),
        ({"nominal": 677.0, "identified": 9.0}, "does not describe these logs"),
        ({"nominal": 60.0, "identified": 9.0}, "No effect that the model lacks shows"),
    ],
)
def test_nothing_named_is_not_always_nothing_missing(levels, words) -> None:
    nothing = replace(made.nothing().verdict, log_check=None)
    error = replace(nothing.error, overall_moving=levels)
    assert words in headline(replace(nothing, error=error))


def test_a_suspected_fault_comes_before_the_effects() -> None:
    fault = Fault("torque_sign", (2,), False, "it drives", repair="sign = -1")
    report = LogCheck((fault,))
    told = headline(replace(made.nothing().verdict, log_check=report))
    assert told.startswith("No effect is named, but the logs may be at fault: ")


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (6983.2, 41.7, "N m", "6983 ± 42 N m"),
        (7031.0, 212.0, "N m", "7030 ± 210 N m"),
        (-0.0532, 0.0021, "rad", "-0.0532 ± 0.0021 rad"),
        (1.2e-7, 3e-8, "kg m^2", "(1.20 ± 0.30)e-7 kg m²"),
        (3.14159, None, "N m s^2/rad^2", "3.14 N m s²/rad²"),
        (3.14159, 0.0, "1", "3.14"),
        (0.0, 0.5, "-", "0.00 ± 0.50"),
        (float("nan"), 0.1, "kg", "–"),
        (True, None, "kg", "–"),
    ],
)
def test_values_are_cut_at_what_is_known(
    value: object, std: object, unit: object, text: str
) -> None:
    assert quantity.measured(value, std, unit) == text


def test_what_the_rest_depends_on_is_said_joint_by_joint() -> None:
    told = {"joint": 4, "of": [], "form": "curve", "share": 0.97, "frequency": None}
    left = {
        "joints": [2, 4, 5],
        "depends_on": [
            told | {"on": "frequency", "frequency": 5.4634},
            told | {"joint": 5, "on": "q", "of": [5, 6], "form": "difference"},
            told | {"joint": 5, "on": "t", "form": "by direction", "share": 0.2},
        ],
    }
    said = " ".join(unexplained_words(typed({"unexplained": left})))
    assert "Of what joint 4 keeps, 97.0 % swings at 5.46 Hz." in said
    assert "joint 5 keeps, 97.0 % follows q5 - q6 and 20.0 % drifts with time" in said
    assert "What the rest on joint 2 depends on is not known." in said
