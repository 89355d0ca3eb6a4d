"""The page of a robot: verdicts, errors, parameters, alarms, adoptions, runs."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from flows.report.document import (
    Document,
    Fold,
    Note,
    Part,
    Section,
    Table,
    Tile,
    link,
    tag,
    when,
)
from flows.report.night import questions
from flows.report.night.charts import Series, trend
from flows.report.night.look import Look, Place, Rows, coloured
from flows.report.words.phrases import joint_words, many, texts
from residual.quantity import MISSING, bare_percent, known, number, percent

_TEXT = texts()["robot"]

_ROWS = 40  # rows of a table; the rest is in SQL
_DRAWN = 24  # parameters that are drawn
_SMALL = 300.0  # width of one of them


def document(look: Look, robot: str, place: Place) -> Document:
    """Return the page of a robot."""
    found = [d for d in look.diagnoses if d["robot"] == robot]
    own = {
        name: [row for row in getattr(look, name) if row["robot"] == robot]
        for name in ("watched", "adoptions", "runs")
    }
    headline = f"{robot} has not been diagnosed yet."
    if found:
        headline = f"{found[0]['title']}: {look.words(found[0]['id'])[0]}"
    about = Markup("Robot <b>{}</b> · {}")
    return Document(
        title=f"modelgap: {robot}",
        about=about.format(robot, link(place.index(robot), "all its reports")),
        headline=headline,
        tiles=_tiles(found, own),
        sections=(
            _errors(found, own["adoptions"]),
            _verdicts(found, robot, look, place),
            _parameters(look.ask(questions.PARAMETERS, robot=robot)),
            _alarms(own["watched"], place),
            _adoptions(own["adoptions"], place),
            _runs(own["runs"], place),
        ),
    )


def _calm(words: str) -> list[Part]:
    return [Note(words, "calm")]


def _tiles(found: Rows, own: Mapping) -> list[Tile]:
    last = own["adoptions"][0] if own["adoptions"] else None
    back = last is not None and last["diagnosis_id"] is None
    model = "nominal" if last is None or back else f"no. {int(last['id'])}"
    since = f"since {last['created']:%Y-%m-%d}" if last else "as it was described"
    alarms = sum(bool(row["alarms"]) for row in own["watched"])
    times = len(own["watched"])
    latest = f"last {found[0]['created']:%Y-%m-%d %H:%M} UTC" if found else "none yet"
    tiles = [
        Tile("Model", model, since),
        Tile("Diagnoses", str(len(found)), latest),
        Tile(
            "Alarms",
            str(alarms) if times else MISSING,
            f"watched {many(times, 'time')}",
        ),
        Tile("Runs", str(len(own["runs"])), "stored"),
    ]
    if found and known(found[0]["before"]):
        fall = f"{bare_percent(found[0]['before'])} → {percent(found[0]['after'])}"
        end = "with the findings" if found[0]["verdict"] == "effects" else "refitted"
        tiles.insert(1, Tile("Held-out error", fall, f"its model → {end}"))
    return tiles


def _errors(found: Rows, adoptions: Rows) -> Section:
    # By when the arm was measured: a night may be diagnosed late.
    oldest_first = sorted(found, key=lambda d: d["recorded"])
    before = [(d["recorded"], d["before"]) for d in oldest_first]
    after = [(d["recorded"], d["after"]) for d in oldest_first]
    lines = (
        Series("model that it had", "before", before),
        Series("with the findings", "after", after),
    )
    marks = [(a["created"], f"no. {int(a['id'])}: {a['action']}") for a in adoptions]
    chart = trend(lines, "%", _TEXT["over_time"], 760.0, marks=marks)
    parts = _calm("No diagnosis with a proof yet.")
    return Section(
        "errors",
        "Held-out error over time",
        [chart, _versions(found)] if chart else parts,
    )


def _versions(found: Rows) -> Table:
    """Errors of each model that the robot had, the first one first."""
    groups: dict[int, list[Mapping]] = defaultdict(list)
    for each in found:
        groups[each["model"] or 0].append(each)
    rows = []
    for model, those in sorted(groups.items()):
        values = [d["before"] for d in those if known(d["before"])]
        mean = percent(sum(values) / len(values)) if values else MISSING
        ends = (min(values), max(values)) if values else (None, None)
        spread = f"{bare_percent(ends[0])} – {percent(ends[1])}"
        name = f"no. {model}" if model else "nominal"
        rows.append((name, str(len(those)), mean, spread))
    about = "By model version: error of the model as it was, before anything was found"
    return Table(("Model", "Diagnoses", "Mean error", "From – to"), rows, about)


def _verdicts(found: Rows, robot: str, look: Look, place: Place) -> Section:
    named = _named(look.ask(questions.EFFECTS, robot=robot), found)
    rows = [
        (
            link(place.diagnosis(d), f"#{d['number']}"),
            when(d["created"]),
            link(place.diagnosis(d), coloured(look.state(d), look.words(d["id"])[0])),
            f"no. {d['model']}" if d["model"] else "nominal",
            percent(d["before"]),
            percent(d["after"]),
        )
        for d in found[:_ROWS]
    ]
    heads = ("No.", "When (UTC)", "Verdict", "Model before", "Error before", "after")
    table = Table(heads, rows, left=(1, 2, 3), named=2, look="")
    more = len(found) - _ROWS
    earlier = link(place.index(robot), f"{more} earlier ones") if more > 0 else None
    parts = [named, table, earlier] if found else _calm("None yet.")
    return Section("verdicts", "Verdicts", parts)


def _named(rows: Rows, found: Rows) -> Table | None:
    """Which effect was named when: a row each, a dot per diagnosis, oldest first."""
    order = found[: 2 * _ROWS][::-1]
    seen: dict[str, set[str]] = defaultdict(set)
    for row in rows:
        where = joint_words(row["joints"] or ())
        name = row["name"].replace("_", " ")
        seen[f"{name}{f' on {where}' if where else ''}"].add(row["id"])
    cells = []
    for name, ids in sorted(seen.items(), key=lambda one: -len(one[1])):
        dots = [_dot(d, d["id"] in ids) for d in order]
        first = min((d["number"] for d in found if d["id"] in ids), default=0)
        told = f"{len(ids)} of {len(order)}, first in #{first}"
        cells.append((name, tag("span", Markup("").join(dots), "dots"), told))
    about = "What was named when, oldest on the left"
    heads = ("Effect", "Diagnoses", "Named in")
    several = cells and len(found) > 1
    return Table(heads, cells, about, left=(0, 1)) if several else None


def _dot(diagnosed: Mapping, there: bool) -> Markup:
    words = f"#{diagnosed['number']}: {'named' if there else 'not named'}"
    return Markup('<span title="{}">{}</span>').format(words, "●" if there else "·")


def _parameters(rows: Rows) -> Section:
    """The parameters drawn, those beyond their limits first, and the rest."""
    groups: dict[tuple, list[Mapping]] = defaultdict(list)
    for row in rows:
        groups[row["joint"], row["name"], row["unit"]].append(row)
    order = sorted(groups.values(), key=_off, reverse=True)
    drawn = [own for own in order if len(own) > 1][:_DRAWN]
    rest = [own for own in order if own not in drawn]
    heading = "Parameters and their limits"
    if not order:
        parts = _calm("No model of it has been identified yet.")
        return Section("parameters", heading, parts)
    parts: list[Part] = [[chart for own in drawn if (chart := _chart(own))]]
    if rest:
        why = "more" if drawn else "of one model, nothing to compare yet"
        heads = ("Parameter", "Last value", "Centre", "Three sigma")
        cells = [
            (_label(own), *(number(own[-1][key]) for key in _FIGURES)) for own in rest
        ]
        parts.append(Fold(f"{len(rest)} {why}", [Table(heads, cells)]))
    return Section("parameters", heading, parts, _TEXT["limits"])


_FIGURES = ("value", "centre", "width")


def _off(own: Sequence[Mapping]) -> tuple[bool, float]:
    """Whether a parameter is beyond its limits, and how far it is off in them."""
    value, centre, width = (own[-1][key] for key in _FIGURES)
    moved = abs(value - centre) / width if width and centre is not None else 0.0
    return moved > 1, moved


def _label(own: Sequence[Mapping]) -> str:
    unit = own[-1]["unit"]
    return f"{own[-1]['name']} [{unit}]" if unit else own[-1]["name"]


def _chart(own: Sequence[Mapping]):
    _, centre, width = (own[-1][key] for key in _FIGURES)
    limits = (centre - width, centre + width) if width else None
    beyond = Markup("<b>beyond its limits</b> · ") if _off(own)[0] else ""
    points = [(row["recorded"], row["value"]) for row in own]
    line = Series(own[-1]["name"], "value", points)
    return trend([line], own[-1]["unit"] or "", beyond + _label(own), _SMALL, limits)


def _alarms(watched: Rows, place: Place) -> Section:
    lines = [
        Markup("{}: in {}: {}").format(
            link(place.record(row["id"]), when(row["created"])),
            many(row["runs"], "run"),
            ", ".join(sorted(row["what"] or ())),
        )
        for row in watched
        if row["alarms"]
    ][:_ROWS]
    times = "once" if len(watched) == 1 else f"{len(watched)} times"
    none = f"None, and it was watched {times}."
    calm = _calm(none if watched else "It has not been watched yet.")
    return Section("alarms", "Alarms of its sensors", [lines] if lines else calm)


def _adoptions(rows: Rows, place: Place) -> Section:
    cells = [
        (
            link(place.record(row["id"]), int(row["id"])),
            when(row["created"]),
            row["action"],
            link(place.record(row["diagnosis_id"]), row["diagnosis_id"][:8])
            if row["diagnosis_id"]
            else "nominal",
            f"{bare_percent(row['before'])} → {percent(row['after'])}",
            ": ".join(filter(None, (row["who"], row["note"]))),
        )
        for row in rows
    ]
    heads = ("No.", "Since (UTC)", "What", "Diagnosis", "Error", "Who, note")
    table = Table(heads, cells, left=(0, 1, 2, 3, 5))
    none = _calm("The nominal one only: nothing has been adopted.")
    return Section("adoptions", "Models that it had", [table] if rows else none)


def _runs(rows: Rows, place: Place) -> Section:
    cells = [
        (
            link(place.record(row["id"]), row["id"][:8])
            + (" (in quarantine)" if row["quarantined"] else ""),
            row["log"] or MISSING,
            ", ".join(row["tags"] or ()) or MISSING,
            when(row["created"]),
            row["trajectory"] or MISSING,
            row["source"],
            number(row["duration_s"]),
            MISSING if row["seed"] is None else str(row["seed"]),
        )
        for row in rows[:_ROWS]
    ]
    heads = ("Run", "Log", "Tags", "Stored (UTC)", "Motion", "Source")
    table = Table((*heads, "Length [s]", "Seed"), cells, left=range(6))
    more, left = len(rows) - _ROWS, Markup("{} earlier ones: <kbd>modelgap runs</kbd>")
    parts = [table, Note(left.format(more)) if more > 0 else None]
    return Section("runs", "Runs", parts if rows else _calm("None."))
