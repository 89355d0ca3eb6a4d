"""Groups, draws and bars of the benchmark of what changed."""

from argparse import Namespace

from benchmarks.attribution_parts import bars

ROW = {
    "group": "sets",
    "arm": "six",
    "off": 3,
    "outcome": "exact",
    "planted": [["payload", [6]], ["coulomb", [2]]],
    "said": [[["payload", [6]]], [["coulomb", [2]]]],
    "true": 2,
    "exact": True,
    "listed": False,
    "unexplained": [],
}
FALSE = {"exact": False, "true": 1, "said": [[["payload", [6]]], [["offset", [1]]]]}


def figures_of(rows, deciding=True):
    return bars.all_figures(rows, Namespace(deciding=deciding))


def rows(good, bad, **wrong):
    return [ROW] * good + [{**ROW, **FALSE, **wrong}] * bad


def test_a_set_counts_if_it_is_exact_or_listed():
    figures = figures_of(rows(9, 1))
    assert figures["rough_values_exact_or_listed"]["ok"] is True
    assert figures["rough_values_names_true"]["value"] == 19 / 20
    listed = figures_of(rows(1, 1, listed=True))
    assert listed["rough_values_exact_or_listed"]["value"] == 1.0
    exact = [row | {"off": 0} for row in rows(1, 1, listed=True)]
    figures = figures_of(exact)
    assert figures["exact_values_set_exact"]["value"] == 0.5
    few = figures_of(rows(1, 9), deciding=False)
    assert few["rough_values_exact_or_listed"]["ok"] is None
