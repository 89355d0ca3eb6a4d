"""A blind study: its figures in the terminal, and all of it as a page in the store."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import erf

from flows.blind.draw import StudyRequest
from flows.blind.run import Study
from flows.blind.score import CLASS, NOTHING, PAIR, RIGHT, SINGLE, UNKNOWN, Name
from flows.report.document import (
    Callout,
    Chart,
    Document,
    Section,
    Table,
    Tile,
    words_table,
)
from flows.report.figures import look
from flows.report.page import Made, made_of
from flows.report.page import render as render_page
from flows.report.words.phrases import texts
from residual.quantity import MISSING
from warehouse.commit import commit_record
from warehouse.ids import record_folder

_TEXT = texts()["study"]

_BLUE, _AMBER, _RED = look.AFTER, "#e69f00", look.BEFORE
_FAR = 4.0  # standard deviations that the curve of coverage is drawn to
_HEIGHT = 320


def store_page(asked: StudyRequest, study: Study, store: Path) -> Path:
    """Write the page of a study into the store."""
    about = {
        "robot": asked.robot,
        "seed": asked.seed,
        "n": asked.n,
        "id": study.id,
        "failed": list(study.failed),
    }
    words = f"--n {asked.n} --seed {asked.seed} --background {asked.background}"
    words += f" --duration {asked.duration:g}"
    made = made_of(store, study.id)
    made = replace(made, what="study", command=f"modelgap blind {words}")
    page = render(study.rows, study.summary, about, made).encode()
    kind = {"robot": asked.robot, "kind": "blind"}
    parents, files = {"study": [study.id]}, {"report.html": page}
    id = commit_record(store, "reports", kind, None, parents, files)
    return record_folder(store, "reports", id) / "report.html"


def told(study: Study) -> list[str | Table]:
    """Return the figures of a study for the terminal, and what did not run."""
    heads = ("what", "value", "cases (95 % Wilson interval)")
    parts = [headline(study.summary), Table(heads, lines(study.summary), left=(0, 2))]
    if study.known:
        known = f"{study.known} of {len(study.rows)} cases were in the store already"
        parts.append(known)
    return [*parts, *(f"failed: {line}" for line in study.failed)]


def render(
    rows: Sequence[Mapping], summary: Mapping, about: Mapping, made: Made | None = None
) -> str:
    """Return the page of a study.

    Args:
        about: ``robot``, ``seed``, ``n``, ``id``, and ``failed`` in words.
    """
    of = f"{about['robot']}, seed {about['seed']}"
    heads = ("What", "Value", "Cases (95 % Wilson interval)")
    page = Document(
        title=f"modelgap blind study: {of}",
        about=f"modelgap blind study of {of}, {about['n']} cases",
        headline=headline(summary),
        tiles=_tiles(summary),
        setting=_TEXT["setting"].format(id=about["id"]),
        callouts=[Callout("Not run to the end", about["failed"])],
        foot=made.facts if made else (),
        sections=(
            Section("figures", "Figures", [Table(heads, lines(summary), left=(0, 2))]),
            Section(
                "confusion",
                "What was hidden, and what was named first",
                [_confusion(summary["confusion"])],
                _TEXT["confusion"],
            ),
            Section(
                "outcomes", "Kinds of cases and how they came out", [_outcomes(summary)]
            ),
            Section(
                "curves", "How small, how sure, how good", [_curves(rows, summary)]
            ),
            Section("cases", "Every case that is not plainly right", [_cases(rows)]),
            Section("read", "How to read this page", [texts()["read_study"]]),
        ),
    )
    return render_page(page)


def lines(summary: Mapping) -> list[tuple[str, str, str]]:
    """Return the figures in words: what, the rate, its count and interval."""
    out = []
    for key, words in texts()["rates"].items():
        one = summary[key]
        if one["n"]:
            value, count, interval = _rate(one)
            out.append((words, value, f"{count} ({interval})"))
    errors, off = summary["errors"], summary["parameter_error"]
    medians = {
        "over_oracle": (errors["over_oracle"], "{:.3g}", errors["n"]),
        "gap_closed": (errors["gap_closed"], "{:.0%}", errors["gaps"]),
        "off_by": (off["median"], "{:.1%}", off["n"]),
    }
    for key, (value, form, n) in medians.items():
        if value is not None:
            shown = form.format(value).replace("%", " %")
            out.append((_TEXT[key], shown, f"median of {n}"))
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


def _tiles(summary: Mapping) -> list[Tile]:
    out = []
    for key, label in texts()["rate_tiles"].items():
        one = summary[key]
        if one["n"]:
            value, count, interval = _rate(one)
            out.append(Tile(label, value, f"{count}; {interval}"))
    return out


def _rate(one: Mapping) -> tuple[str, str, str]:
    """A rate in words: its value, what it was counted from, its interval."""
    low, high = (f"{100 * v:.0f}" for v in one["interval"])
    value, count = f"{100 * one['value']:.0f} %", f"{one['hits']} of {one['n']}"
    return value, count, f"{low} to {high} %"


def _outcomes(summary: Mapping) -> Table:
    table = summary["outcomes"]
    heads = sorted({o for counts in table.values() for o in counts})
    kinds = [k for k in (SINGLE, PAIR, NOTHING, UNKNOWN) if k in table]
    rows = [(k, *(str(table[k].get(o, 0)) for o in heads)) for k in kinds]
    return Table(("Drawn", *heads), rows)


def _confusion(counts: Mapping[str, Mapping[str, int]]) -> Chart | None:
    """The matrix of what was hidden against what was said first."""
    if not counts:
        return None
    last = (NOTHING, UNKNOWN)
    said = {name for row in counts.values() for name in row}
    rows = [r for r in counts if r not in last and not r.startswith("x_")]
    columns = [c for c in sorted({*rows, *said}) if c not in last]
    rows += [r for r in counts if r.startswith("x_")]
    rows += [r for r in last if r in counts]
    columns += last
    wrong = [f"{t} as {s}" for t in rows for s in counts[t] if s != t and s not in last]
    alt = (
        f"True effect against first name. Off the diagonal: {', '.join(wrong) or '–'}."
    )
    data = [_cells(counts, rows, columns, colour) for colour in (_BLUE, _AMBER, _RED)]
    x = look.axis("", side="top", tickangle=-90)
    y = look.axis("", autorange="reversed")
    plot = {"data": data, "layout": look.layout("", x, y)}
    return Chart("", alt, plot=plot, height=220 + 26 * len(rows))


def _cells(
    counts: Mapping, rows: Sequence[str], columns: Sequence[str], colour: str
) -> look.Trace:
    """The cells of one colour: the more of its row, the deeper."""
    own = [
        [counts[r].get(c, 0) if _colour(r, c) == colour else 0 for c in columns]
        for r in rows
    ]
    shares = [
        [n / sum(counts[r].values()) if n else None for n in row]
        for r, row in zip(rows, own, strict=True)
    ]
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return {
        "type": "heatmap",
        "x": [_word(c) for c in columns],
        "y": [_word(r) for r in rows],
        "z": shares,
        "text": [[str(n) if n else "" for n in row] for row in own],
        "texttemplate": "%{text}",
        "hovertemplate": "%{y} as %{x}: %{text}<extra></extra>",
        "colorscale": [[0, f"rgba({red},{green},{blue},0.25)"], [1, colour]],
        "zmin": 0,
        "zmax": 1,
        "showscale": False,
        "xgap": 1,
        "ygap": 1,
    }


def _colour(true: str, said: str) -> str:
    """Right, silent, or a false name."""
    unnamed = true.startswith("x_")
    if said == (UNKNOWN if unnamed else true):
        return _BLUE
    return _AMBER if said in (NOTHING, UNKNOWN) else _RED


def _word(name: str) -> str:
    return name.replace("_", " ")


def _curves(rows: Sequence[Mapping], summary: Mapping) -> list[Chart]:
    errors = [r for r in rows if r["drawn"] in (SINGLE, PAIR) and r["error_oracle"]]
    z = [r["z"] for r in rows if r["z"] is not None]
    charts = []
    if summary["detection"]:
        charts.append(_detection(summary["detection"]))
    if z:
        charts.append(_coverage(z, summary["coverage"]))
    if errors:
        charts.append(_errors(errors, summary["errors"]))
    return charts


def _chart(title: str, alt: str, caption: str, data: list, x: dict, y: dict) -> Chart:
    layout = look.layout(title, x, y)
    plot = {"data": data, "layout": layout}
    return Chart("", alt, caption, plot=plot, height=_HEIGHT)


def _detection(points: Sequence[Mapping]) -> Chart:
    """The share rightly named over the size in minimum detectable ones."""
    told = "; ".join(
        f"{p['multiple']:.2g} times: {p['hits']} of {p['n']}" for p in points
    )
    y = np.array([100 * p["value"] for p in points])
    low, high = 100 * np.array([p["interval"] for p in points]).T
    bars = {
        "type": "data",
        "symmetric": False,
        "array": np.maximum(high - y, 0).tolist(),
        "arrayminus": np.maximum(y - low, 0).tolist(),
    }
    style = look.line("rightly named", _BLUE, mode="lines+markers+text")
    data = style | {
        "x": [p["multiple"] for p in points],
        "y": y.tolist(),
        "error_y": bars,
        "text": [f"n = {p['n']}" for p in points],
        "textposition": "bottom right",
    }
    ticks = {"tickvals": [1, 3, 5, 10], "ticktext": ["1×", "3×", "5×", "10×"]}
    caption = (
        "Single effects rightly named over their size. At once the minimum detectable "
        "size about half should be."
    )
    x = look.axis("size over the minimum detectable size", type="log", **ticks)
    rate = look.axis("rightly named (%)", range=[0, 104])
    return _chart("", f"Rightly named at {told}.", caption, [data], x, rate)


def _coverage(z: Sequence[float], one: Mapping) -> Chart:
    """The share of truths within so many standard deviations."""
    at = np.linspace(0, _FAR, 161)
    share = 100 * np.searchsorted(np.sort(np.abs(z)), at, side="right") / len(z)
    dash = {"dash": "dash"}
    data = [
        look.line("as it should be", look.SOFT, 1, line=dash)
        | {"x": look.packed(at), "y": look.packed(100 * erf(at / np.sqrt(2)))},
        look.line("measured", _BLUE, 1.6, line={"shape": "hv"})
        | {"x": look.packed(at), "y": look.packed(share)},
    ]
    alt = f"{one['hits']} of {one['n']} estimates within two standard deviations."
    caption = (
        "Main parameter of single effects that were named: how many truths lie within "
        "so many standard deviations."
    )
    x = look.axis("standard deviations from the truth", range=[0, _FAR])
    y = look.axis("estimates within (%)", range=[0, 104])
    return _chart("", alt, caption, data, x, y)


def _errors(rows: Sequence[Mapping], medians: Mapping) -> Chart:
    """The held-out error of every case before, refitted and after.

    Over the oracle's error, which nothing but luck gets below.
    """
    told = ", ".join(
        f"{name} {medians[f'error_{name}']:.3g} %"
        for name in ("before", "refit", "after", "oracle")
    )
    oracle = [r["error_oracle"] for r in rows]
    ends = [0.8 * min(oracle), 1.25 * max(oracle)]
    style = look.line("oracle", look.SOFT, 1, line={"dash": "dash"})
    data = [style | {"x": ends, "y": ends}]
    for key, stage, label in (
        ("error_before", "nominal", "nominal"),
        ("error_refit", "identified", "refitted"),
        ("error_after", "augmented", "with what was found"),
    ):
        mark: dict[str, Any] = {"color": look.STAGES[stage], "size": 6, "opacity": 0.8}
        points = {"x": oracle, "y": [r[key] for r in rows], "marker": mark}
        data.append({"type": "scatter", "mode": "markers", "name": label} | points)
    caption = (
        "Held-out error, filtered, all joints, over what the true effects reach when "
        "they are fitted."
    )
    x = look.axis("error with the true effect fitted (%)", type="log")
    y = look.axis("held-out error (%)", type="log")
    return _chart("", f"Median errors: {told}.", caption, data, x, y)


def _cases(rows: Sequence[Mapping]) -> Table | None:
    heads = ("Case", "Hidden (times detectable)", "Named first", "Outcome")
    cases = [_case(r) for r in rows if r["outcome"] not in (RIGHT, CLASS)]
    return (
        words_table((*heads, "Flagged joints", "Diagnosis"), cases) if cases else None
    )


def _case(row: Mapping) -> tuple[str, ...]:
    hidden = [
        f"{Name(row[f'{s}effect'], tuple(row[f'{s}joints']))}{_times(row, s)}"
        for s in ("", "second_")
        if row[f"{s}effect"]
    ]
    said = row["named_first"]
    first = str(Name(said, tuple(row["named_joints"]))) if said else MISSING
    return (
        str(row["case_index"]),
        " + ".join(hidden) or "nothing",
        first + (f" and {row['named'] - 1} more" if row["named"] > 1 else ""),
        row["outcome"],
        ", ".join(map(str, row["unexplained"])) or MISSING,
        row["diagnosis_id"],
    )


def _times(row: Mapping, start: str) -> str:
    value = row[f"{start}multiple"]
    return "" if value is None else f" ({value:.2g}×)"
