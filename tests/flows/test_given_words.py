"""Given values that are off, and sets that are as good, in sentences."""

import pytest

from flows.report.words.outlook import off_words, other_sets, value_rows
from residual.diagnosis.result import Verdict
from tests.flows.report_outcomes import effect, given_value, parameter
from tests.verdict_documents import typed

DRIVES = ("viscous", "coulomb", "rotor_inertia")
SPRING = {"name": "spring", "joints": [2]}
BALANCER = {"name": "balancer", "joints": [2]}
STRIBECK = {"name": "stribeck", "joints": [3]}
MOTION, TELLS = "motion", "Another motion would tell them apart."


def another(*places: dict, by: str = MOTION) -> dict:
    """Return one entry of verdict["alternatives"]."""
    return {"set": list(places), "nats": -2.0, "separated_by": by}


def verdict(*effects: dict, **part: object) -> Verdict:
    return typed({"declared": DRIVES, "effects": list(effects), **part})


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ([], ""),
        ([given_value("coulomb", 1, beyond=False)], ""),
        ([given_value("coulomb", 1, explained=True)], ""),
        (
            [given_value("coulomb", 1)],
            "But one of its values is off: coulomb level of joint 1 (4 → 4.6 N m).",
        ),
        (
            [given_value("inertial", 3), given_value("coulomb", 2)],
            "But two of its values are off: coulomb level of joint 2 (4 → 4.6 N m) and "
            "one sum of masses and inertias.",
        ),
        (
            [given_value("inertial", 3), given_value("inertial", 4)],
            "But two of its values are off: two sums of masses and inertias.",
        ),
    ],
)
def test_values_that_are_off_are_counted_and_named(changes, sentence):
    assert off_words(verdict(changes=changes)) == sentence


@pytest.mark.parametrize(
    ("change", "cells"),
    [
        (given_value("coulomb", 1), ("coulomb level of joint 1", "4 N m", "+15 %")),
        (
            given_value("rotor_inertia", 2),
            ("rotor inertia of joint 2", "4 N m", "+15 %"),
        ),
        (
            given_value("viscous", 3, 0.0, 1.0),
            ("viscous coefficient of joint 3", "0 N m", ""),
        ),
        (given_value("inertial", 2, -4.0, -5.0), ("m3 + m4", "-4 N m", "-25 %")),
        (
            given_value("inertial", 2, parameter="m3 + m4 + m5"),
            ("m3 + m4 + ...", "4 N m", "+15 %"),
        ),
    ],
)
def test_a_row_says_what_it_is_as_given_and_by_how_much_it_is_off(change, cells):
    one = verdict(changes=[change])
    (row,) = value_rows(one.changes, one)
    what, nominal, _, off = (cell.replace("−", "-") for cell in row)
    assert (what, nominal, off) == cells


@pytest.mark.parametrize(
    ("sets", "lines"),
    [
        ([], []),
        (
            [another(BALANCER, STRIBECK)],
            [
                "As likely: a balancer on joint 2 and Stribeck friction on joint 3.",
                TELLS,
            ],
        ),
        ([another()], ["As likely: nothing.", TELLS]),
        (
            [another(BALANCER, STRIBECK, by="nothing")],
            [
                "As likely: a balancer on joint 2 and Stribeck friction on joint 3.",
                "No motion tells them apart.",
            ],
        ),
    ],
)
def test_other_sets_are_said_one_by_one(sets, lines):
    found = verdict(effect("spring", [2], {}), alternatives=sets)
    assert other_sets(found) == lines


def test_a_set_that_an_equivalent_says_already_is_not_said_again():
    found = effect("spring", [2], {}, equivalent=[BALANCER])
    assert other_sets(verdict(found, alternatives=[another(BALANCER)])) == []
    several = effect("coulomb", [1, 2], {"level": parameter([1, 2], [0, 0], "N m")})
    swap = another(
        {"name": "coulomb", "joints": [1]}, {"name": "coulomb", "joints": [2]}, SPRING
    )
    said = other_sets(
        verdict(
            several,
            effect("balancer", [2], {}, equivalent=[SPRING]),
            alternatives=[swap],
        )
    )
    assert said == []
