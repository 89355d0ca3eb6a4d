"""Figures of each program, and the tables of all."""

from collections.abc import Mapping

from benchmarks.harness.figures import NO_BAR, Figures, figure
from benchmarks.harness.rates import Rows, at_least, share
from flows.blind.export import score

TITLES = {"ours": "modelgap", "squares": "least squares", "sparse": "sparse selection"}
KINDS = {
    "single": "one effect",
    "pair": "two effects",
    "none": "nothing",
    "unknown": "no name",
    "all": "all",
}
LEVELS = {
    "name": "Effect and joint by name",
    "equivalent": "The same, or one of the equivalents that it states",
    "class": "By coarse class: body, friction or rotor, the rest",
}


def all_figures(rows: Mapping[str, Rows]) -> Figures:
    out: Figures = {}
    for program, own in rows.items():
        good = [row for row in own if "outcome" in row]
        kinds = score.summed(good)["kinds"]
        every = kinds["all"]
        for level in score.LEVELS:
            for key, entry in every["levels"][level].items():
                out[f"{program}_{key}_{level}"] = _rate(entry)
        none, odd = (kinds.get(k) for k in ("none", "unknown"))
        out[f"{program}_named_on_nothing"] = _rate(none and none["named"])
        out[f"{program}_unknown_flagged"] = _rate(odd and odd["flagged"])
        out[f"{program}_joint"] = _rate(every["joint"])
        for key in ("held_out_over_oracle", "edit_over_oracle"):
            entry = every[key]
            value = figure(entry["median"], None, entry["n"], why=NO_BAR)
            out[f"{program}_{key}"] = value
        seconds = score.middle([row["seconds"] for row in good])
        out[f"{program}_seconds"] = figure(
            seconds["median"], None, len(good), why=NO_BAR
        )
    crashes = sum("error" in row for own in rows.values() for row in own)
    return out | {"crashes": figure(crashes, 0, sum(map(len, rows.values())))}


def tables(rows: Mapping[str, Rows]) -> list[dict]:
    """Return tables of programs by kind of case: title and rows of texts."""
    every = {
        program: score.summed([row for row in own if "outcome" in row])["kinds"]
        for program, own in rows.items()
    }
    keys = ("exact", "precision", "recall")
    out = []
    for level, title in LEVELS.items():
        lines = [["program", "hidden", "exact set", "precision", "recall"]]
        lines += [
            [*at, *(_cell(kind["levels"][level][key]) for key in keys)]
            for at, kind in _lines(every)
        ]
        out.append({"title": title, "rows": lines})
    head = ["program", "hidden", "named", "said unknown", "on a right joint"]
    lines = [[*head, "held-out error over oracle", "edit error over oracle"]]
    for at, kind in _lines(every):
        cells = [_cell(kind[key]) for key in ("named", "flagged", "joint")]
        ratios = [kind[key] for key in ("held_out_over_oracle", "edit_over_oracle")]
        lines.append([*at, *cells, *map(_ratio, ratios)])
    return [*out, {"title": "What else was said, and predicted", "rows": lines}]


def _lines(every: Mapping[str, Mapping]):
    for program, kinds in every.items():
        for kind, word in KINDS.items():
            if kind in kinds:
                yield (TITLES[program], word), kinds[kind]


def _cell(entry: Mapping) -> str:
    if not entry["n"]:
        return "–"
    low, high = (round(100 * x) for x in entry["interval"])
    return f"{entry['hits']} of {entry['n']} ({low} to {high} %)"


def _rate(entry: Mapping | None) -> dict:
    known = (entry["hits"], entry["n"]) if entry and entry["n"] else None
    return at_least(share(*known) if known else figure(None, None, 0), None)


def _ratio(entry: Mapping) -> str:
    return f"{entry['median']:.3g} ({entry['n']})" if entry["n"] else "–"
