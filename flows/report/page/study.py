"""A blind study as one HTML page, and in a few lines, in the look of the report."""

from collections.abc import Mapping, Sequence
from typing import Any

from flows.blind.score import CLASS, NOTHING, PAIR, RIGHT, SINGLE, UNKNOWN, Name
from flows.report.made import Made
from flows.report.page import study_plots as plots
from flows.report.page.base import Tile, environment
from flows.report.page.chart import Chart
from residual.quantity import MISSING

_RATES = {
    "singles_clear_right": "One effect, three times detectable or more: rightly named",
    "singles_of_usual_size_right": "One effect without such a unit, of usual size",
    "singles_right": "One effect of any size: rightly named",
    "singles_by_name": "One effect of any size: by its very name, not its class",
    "joint_right": "One effect: the first name is on the right joint",
    "named_right": "Something named: the first name is right",
    "names_none_false": "Something named: no name is false",
    "false_alarms": "Nothing hidden: something named",
    "nulls_flagged": "Nothing hidden: a joint flagged, nothing named",
    "unknown_flagged": "Out of the vocabulary: flagged",
    "unknown_joint": "Out of the vocabulary and flagged: on its joint",
    "unknown_named": "Out of the vocabulary: falsely named",
    "pairs_clear_both": "Two effects, both clear: both named",
    "pairs_both": "Two effects: both named",
    "pairs_false_third": "Two effects: a false name beside them",
    "coverage": "Truth within two standard deviations",
}


def render(
    rows: Sequence[Mapping], summary: Mapping, about: Mapping, made: Made | None = None
) -> str:
    """Return the page of a study.

    Args:
        about: ``robot``, ``seed``, ``n``, ``id``, and ``failed`` in words.
    """
    page = environment().get_template("blind.html")
    return page.render(_context(rows, summary, about), made=made)


def lines(summary: Mapping) -> list[tuple[str, str, str]]:
    """Return the figures in words: what, the rate, its count and interval."""
    out = []
    for key, words in _RATES.items():
        one = summary[key]
        if one["n"]:
            low, high = (f"{100 * v:.0f}" for v in one["interval"])
            count = f"{one['hits']} of {one['n']} ({low} to {high} %)"
            out.append((words, f"{100 * one['value']:.0f} %", count))
    errors, off = summary["errors"], summary["parameter_error"]
    if errors["over_oracle"] is not None:
        many = f"median of {errors['n']}"
        words = "Held-out error over that of the true effects fitted"
        out.append((words, f"{errors['over_oracle']:.3g}", many))
    if errors["gap_closed"] is not None:
        words = "Share closed of the gap from a refit to the true effects"
        many = f"median of {errors['gaps']}"
        out.append((words, f"{100 * errors['gap_closed']:.0f} %", many))
    if off["median"] is not None:
        words, many = "Main parameter off by", f"median of {off['n']}"
        out.append((words, f"{100 * off['median']:.1f} %", many))
    return out


def headline(summary: Mapping) -> str:
    """Return the study in one sentence."""
    single, wrong = summary["singles_right"], summary["named_right"]
    alarms = summary["false_alarms"]
    parts = [f"{single['hits']} of {single['n']} single effects rightly named"]
    if wrong["n"]:
        parts.append(f"{wrong['n'] - wrong['hits']} of {wrong['n']} first names wrong")
    if alarms["n"]:
        parts.append(f"{alarms['hits']} false alarms in {alarms['n']} without effect")
    return ", ".join(parts)


def _context(rows: Sequence[Mapping], summary: Mapping, about: Mapping) -> dict:
    errors = [r for r in rows if r["drawn"] in (SINGLE, PAIR) and r["error_oracle"]]
    return {
        "about": about,
        "headline": headline(summary),
        "tiles": _tiles(summary),
        "lines": lines(summary),
        "outcomes": _outcomes(summary),
        "confusion": _confusion(summary["confusion"]),
        "detection": _detection(summary["detection"]),
        "coverage": _coverage(rows, summary),
        "errors": _errors(errors, summary) if errors else None,
        "cases": [_case(r) for r in rows if r["outcome"] not in (RIGHT, CLASS)],
    }


def _tiles(summary: Mapping) -> list[Tile]:
    named = (
        ("singles_clear_right", "Clear effects named"),
        ("names_none_false", "Verdicts without a false name"),
        ("false_alarms", "False alarms"),
        ("unknown_flagged", "Unknown ones flagged"),
        ("coverage", "Within 2 σ"),
    )
    out = []
    for key, label in named:
        one = summary[key]
        if one["n"]:
            low, high = (f"{100 * v:.0f}" for v in one["interval"])
            note = f"{one['hits']} of {one['n']}; {low} to {high} %"
            out.append(Tile(label, f"{100 * one['value']:.0f} %", note))
    return out


def _outcomes(summary: Mapping) -> dict[str, Any]:
    table = summary["outcomes"]
    heads = sorted({o for counts in table.values() for o in counts})
    kinds = [k for k in (SINGLE, PAIR, NOTHING, UNKNOWN) if k in table]
    return {
        "heads": heads,
        "rows": [(kind, [table[kind].get(o, 0) for o in heads]) for kind in kinds],
    }


def _confusion(counts: Mapping[str, Mapping[str, int]]) -> Chart | None:
    if not counts:
        return None
    last = (NOTHING, UNKNOWN)
    said = {name for row in counts.values() for name in row}
    rows = [r for r in counts if r not in last and not r.startswith("x_")]
    columns = [c for c in sorted({*rows, *said}) if c not in last]
    rows += [r for r in counts if r.startswith("x_")]
    rows += [r for r in last if r in counts]
    uri = plots.confusion_figure(counts, rows, [*columns, *last])
    wrong = [f"{t} as {s}" for t in rows for s in counts[t] if s != t and s not in last]
    alt = (
        f"True effect against first name. Off the diagonal: {', '.join(wrong) or '–'}."
    )
    return Chart(uri, alt, "")


def _detection(points: Sequence[Mapping]) -> Chart | None:
    if not points:
        return None
    told = "; ".join(
        f"{p['multiple']:.2g} times: {p['hits']} of {p['n']}" for p in points
    )
    return Chart(plots.detection_figure(points), f"Rightly named at {told}.", "")


def _coverage(rows: Sequence[Mapping], summary: Mapping) -> Chart | None:
    z = [r["z"] for r in rows if r["z"] is not None]
    if not z:
        return None
    one = summary["coverage"]
    alt = f"{one['hits']} of {one['n']} estimates within two standard deviations."
    return Chart(plots.coverage_figure(z), alt, "")


def _errors(rows: Sequence[Mapping], summary: Mapping) -> Chart:
    medians = summary["errors"]
    told = ", ".join(
        f"{name} {medians[f'error_{name}']:.3g} %"
        for name in ("before", "refit", "after", "oracle")
    )
    return Chart(plots.errors_figure(rows), f"Median errors: {told}.", "")


def _case(row: Mapping) -> dict[str, str]:
    hidden = [
        f"{Name(row[f'{s}effect'], tuple(row[f'{s}joints']))}{_times(row, s)}"
        for s in ("", "second_")
        if row[f"{s}effect"]
    ]
    said = row["named_first"]
    first = str(Name(said, tuple(row["named_joints"]))) if said else MISSING
    flagged = ", ".join(map(str, row["unexplained"])) or MISSING
    return {
        "index": str(row["case_index"]),
        "hidden": " + ".join(hidden) or "nothing",
        "said": first + (f" and {row['named'] - 1} more" if row["named"] > 1 else ""),
        "outcome": row["outcome"],
        "flagged": flagged,
        "diagnosis": row["diagnosis_id"],
    }


def _times(row: Mapping, start: str) -> str:
    value = row[f"{start}multiple"]
    return "" if value is None else f" ({value:.2g}×)"
