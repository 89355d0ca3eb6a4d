"""The page of a robot: verdicts, errors, parameters, alarms, adoptions, runs."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

from flows.report.document import Tile
from flows.report.night import questions
from flows.report.night.charts import Series, Trend, trend
from flows.report.night.look import Diagnosed, Look, Place
from flows.report.words.phrases import joint_words
from residual.quantity import bare_percent, known, percent

_ROWS = 40  # rows of a table; the rest is in SQL
_DRAWN = 24  # parameters that are drawn
_SMALL = 300.0  # width of one of them


def context(look: Look, robot: str, place: Place) -> dict:
    """Return what the template `robot.html` is filled with."""
    found = [d for d in look.diagnoses if d.robot == robot]
    own = {
        name: [row for row in getattr(look, name) if row["robot"] == robot]
        for name in ("watched", "adoptions", "runs", "models")
    }
    effects = look.ask(questions.EFFECTS, robot=robot)
    parameters = look.ask(questions.PARAMETERS, robot=robot)
    marks = [
        (a["created"], f"no. {int(a['id'])}: {a['action']}") for a in own["adoptions"]
    ]
    drawn, left = _parameters(parameters)
    return {
        "title": f"modelgap: {robot}",
        "robot": robot,
        "headline": _headline(robot, found, look),
        "tiles": _tiles(found, own, look),
        "verdicts": [_verdict(d, look, place) for d in found[:_ROWS]],
        "more": len(found) - _ROWS,
        "errors": _errors(found, marks),
        "versions": _versions(found),
        "effects": _effects(effects, found),
        "drawn": drawn,
        "left": left,
        "alarms": [row for row in own["watched"] if row["alarms"]][:_ROWS],
        "watched": len(own["watched"]),
        "adoptions": own["adoptions"],
        "runs": own["runs"][:_ROWS],
        "runs_left": len(own["runs"]) - _ROWS,
    }


def _headline(robot: str, found: Sequence[Diagnosed], look: Look) -> str:
    if not found:
        return f"{robot} has not been diagnosed yet."
    return f"{found[0].title}: {look.words(found[0].id)[0]}"


def _tiles(found: Sequence[Diagnosed], own: Mapping, look: Look) -> list[Tile]:
    last = own["adoptions"][0] if own["adoptions"] else None
    back = last is not None and last["diagnosis_id"] is None
    model = "nominal" if last is None or back else f"no. {int(last['id'])}"
    since = f"since {last['created']:%Y-%m-%d}" if last else "as it was described"
    alarms = sum(bool(row["alarms"]) for row in own["watched"])
    times = len(own["watched"])
    watched = f"watched {times} time{'' if times == 1 else 's'}"
    tiles = [
        Tile("Model", model, since),
        Tile("Diagnoses", str(len(found)), _when(found)),
        Tile("Alarms", str(alarms) if times else "–", watched),
        Tile("Runs", str(len(own["runs"])), "stored"),
    ]
    if found and known(found[0].before):
        after = percent(found[0].after)
        fall = f"{bare_percent(found[0].before)} → {after}"
        end = "with the findings" if found[0].verdict == "effects" else "refitted"
        tiles.insert(1, Tile("Held-out error", fall, f"its model → {end}"))
    return tiles


def _when(found: Sequence[Diagnosed]) -> str:
    return f"last {found[0].created:%Y-%m-%d %H:%M} UTC" if found else "none yet"


def _verdict(each: Diagnosed, look: Look, place: Place) -> dict:
    words, _ = look.words(each.id)
    return {
        "title": f"#{each.number}",
        "created": each.created,
        "state": look.state(each),
        "words": words,
        "before": each.before,
        "after": each.after,
        "model": f"no. {each.model}" if each.model else "nominal",
        "href": place.report(each.report, each.id),
    }


def _errors(found: Sequence[Diagnosed], marks: Sequence) -> Trend | None:
    lines = [
        Series("model that it had", "before", [(d.created, d.before) for d in found]),
        Series("with the findings", "after", [(d.created, d.after) for d in found]),
    ]
    oldest_first = [Series(s.name, s.look, s.points[::-1]) for s in lines]
    return trend(oldest_first, "%", 760.0, marks=marks)


def _versions(found: Sequence[Diagnosed]) -> list[dict]:
    """Errors of each model that the robot had, the first one first."""
    groups: dict[int, list[Diagnosed]] = defaultdict(list)
    for each in found:
        groups[each.model or 0].append(each)
    out = []
    for model, those in sorted(groups.items()):
        values = [d.before for d in those if known(d.before)]
        mean = sum(values) / len(values) if values else None
        name = f"no. {model}" if model else "nominal"
        spread = (min(values), max(values)) if values else (None, None)
        out.append({"name": name, "count": len(those), "mean": mean, "spread": spread})
    return out


def _effects(rows: Sequence[Mapping], found: Sequence[Diagnosed]) -> list[dict]:
    """Which effect was named when: a row each, a place per diagnosis, oldest first."""
    if len(found) < 2:
        return []
    order = [d.id for d in found[: 2 * _ROWS]][::-1]
    seen: dict[str, set[str]] = defaultdict(set)
    for row in rows:
        where = joint_words(row["joints"] or ())
        name = row["name"].replace("_", " ")
        seen[f"{name}{f' on {where}' if where else ''}"].add(row["id"])
    numbers = {d.id: d.number for d in found}
    out = [
        {
            "name": name,
            "count": len(ids),
            "cells": [(numbers[id], id in ids) for id in order],
            "first": min((numbers[id] for id in ids if id in numbers), default=0),
        }
        for name, ids in seen.items()
    ]
    return sorted(out, key=lambda row: -row["count"])


def _parameters(rows: Sequence[Mapping]) -> tuple[list[dict], list[dict]]:
    """Return the parameters to draw, those beyond their limits first, and the rest."""
    groups: dict[tuple, list[Mapping]] = defaultdict(list)
    for row in rows:
        groups[row["joint"], row["name"], row["unit"]].append(row)
    made = [_parameter(*key, points) for key, points in groups.items()]
    made.sort(key=lambda p: (-p["beyond"], -p["moved"]))
    drawn = [p for p in made if len(p["points"]) > 1][:_DRAWN]
    for each in drawn:
        each["chart"] = _chart(each)
    return drawn, [p for p in made if "chart" not in p]


def _parameter(joint: int, name: str, unit: str, rows: Sequence[Mapping]) -> dict:
    last, width = rows[-1], rows[-1]["width"]
    off = abs(last["value"] - last["centre"]) if last["centre"] is not None else 0.0
    return {
        "joint": joint,
        "name": name,
        "unit": unit or "",
        "value": last["value"],
        "centre": last["centre"],
        "width": width,
        "moved": off / width if width else 0.0,
        "beyond": bool(width) and off > width,
        "points": [(row["created"], row["value"]) for row in rows],
    }


def _chart(each: Mapping) -> Trend | None:
    width, centre = each["width"], each["centre"]
    limits = (centre - width, centre + width) if width else None
    line = Series(each["name"], "value", each["points"])
    return trend([line], each["unit"], _SMALL, limits)
