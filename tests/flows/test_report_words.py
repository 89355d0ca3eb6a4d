"""The verdict in plain sentences: claim, error, values that are off, alternatives."""

from dataclasses import replace

import pytest

from flows.report.sentences import format_headline as headline
from residual import quantity
from residual.check.result import Fault, LogCheck
from residual.verdict.result import Verdict
from tests.flows import report_outcomes as outcomes
from tests.verdict_documents import typed


def verdict(*effects: dict, kind: str = "effects", **error: object) -> Verdict:
    return typed(outcomes.verdict(kind, list(effects), **error))


def effect(name: str, joints: list[int], **more: object) -> dict:
    return outcomes.effect(name, joints, {}, **more)


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
