"""Write two pages of docs/ and the table of the README from the results files.

    python benchmarks/page.py

benchmarks/words/ describes each figure; a figure without a description is an error.
"""

import math
import statistics
import sys
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.bench import PLAN, read
from benchmarks.harness.origin import ROOT, is_current

README, PAGE = ROOT / "README.md", ROOT / "docs" / "benchmarks.md"
PUBLIC = ROOT / "docs" / "guide" / "public_logs.md"
FENCES = "<!-- results -->\n", "<!-- end of results -->\n"


@cache
def describe(name: str) -> dict:
    text = (ROOT / "benchmarks" / "words" / f"{name}.toml").read_text(encoding="utf-8")
    # The value of each program on one case: a pattern of the key, and a title.
    return {"columns": {"{}": "value"}} | tomllib.loads(text)


@cache
def results() -> dict[str, dict]:
    """Return the results files by name, in the order of the plan."""
    return {name: content for name in PLAN if (content := read(name))}


def list_rows(name: str, figures: Mapping) -> Iterable[tuple[str, str, list[str]]]:
    """Yield what each figure of a file is, its unit, and its key for each program."""
    text = describe(name)
    for key, about in text["figures"].items():
        each = [pattern.format(key) for pattern in text["columns"]]
        if key in figures and key not in each:  # of no program
            each[0] = key
        if any(k in figures for k in each):
            yield about["is"], about["unit"], each


def value_of(entry: Mapping, unit: str) -> str:
    """Return a figure in words: "share" and "count" of n cases, or with its unit."""
    value, n = entry["value"], entry["n"]
    if value is None:
        return "not measured"
    hits = round(value * n) if isinstance(value, float) else value
    if unit == "count":
        return f"{_number(hits)} of {_number(n)}"
    if unit == "share":
        ends = "–".join(_number(100 * x) for x in entry.get("interval", ()))
        percent = f"{_number(100 * hits / n)} %"
        return f"{hits} of {n} ({percent}, {ends})" if ends else f"{hits} of {n} ({percent})"
    repeats = f" (n = {_number(n)})" if n > 1 else ""
    return f"{_number(value)} {unit}".strip() + repeats


def bar_of(entry: Mapping, unit: str) -> str:
    """Return the bar of a figure, and whether it is missed."""
    bar, value = entry["bar"], entry["value"]
    if bar is None:
        return "–"
    percent = unit == "share" and isinstance(value, float)
    low, high = (
        f"{_number(100 * x)} %" if percent else _number(x) for x in (entry.get("low", bar), bar)
    )
    sign = "≥ " if entry.get("at_least") else "≤ "
    if value is None:  # the direction of the bar is not recorded
        sign = ""
    text = f"{low} to {high}" if "low" in entry else sign + high
    return text + {False: " **missed**", None: " *undecided*"}.get(entry["ok"], "")


def page() -> str:
    sections = [_section(name, content) for name, content in results().items()]
    machines = dict.fromkeys(
        f"{content['cores']} cores ({content['machine']}), Python {content['python']}"
        for content in results().values()
    )
    head = describe("page")["head"].format(machines="; ".join(machines))
    return "\n".join([head.lstrip(), *sections, describe("page")["worse"].lstrip()])


def _section(name: str, content: Mapping) -> str:
    text, figures = describe(name), content["figures"]
    rows = [("what", *text["columns"].values(), "bar")]
    for about, unit, keys in list_rows(name, figures):
        cells = [value_of(figures[k], unit) if k in figures else "" for k in keys]
        first = next(figures[k] for k in keys if k in figures)
        rows.append((about, *cells, bar_of(first, unit)))
    facts = f"`results/{name}.json`: {_origin(name, content)}"
    parts = [f"## {text['title']}", facts, text["about"].strip(), _table(rows).rstrip()]
    if "case" in text:
        parts.append(_table(_outside_rows(text["case"])).rstrip())
    return "\n\n".join(filter(None, parts)) + "\n"


def _outside_rows(cases: Iterable[Mapping]) -> list[tuple[str, ...]]:
    """Rows of figures of several files: cases of other people, and their peers."""
    rows = [("what", "source", "modelgap", "peer")]
    for case in cases:
        (about, ours), peer = _look_up(case["figure"]), case.get("peer", "")
        if ours:
            peer = _look_up(peer)[1] if "." in peer else peer
            rows.append((case.get("what", about), case["source"], ours, peer))
    return rows


def _look_up(figure: str) -> tuple[str, str]:
    """Return what a figure, as "file.key", is, and its value; "" where there is none."""
    file, key = figure.split(".")
    figures = results().get(file, {}).get("figures", {})
    for about, unit, keys in list_rows(file, figures):
        if key in keys and key in figures:
            return about, value_of(figures[key], unit).partition(" (")[0]
    return "", ""


def readme_table() -> str:
    """Return the table of results of the README, between its two comments."""
    shared, used = describe("page"), {}
    rows = [("tested on", "counted", "result", "bar")]
    for row in shared["readme"]:
        file, key = row["figure"].split(".")
        if entry := results()[file]["figures"].get(key):
            used[file], unit = results()[file], describe(file)["figures"][key]["unit"]
            shown = value_of(entry, unit), bar_of(entry, unit)
            rows.append((row["on"], row["counted"], *shown))
    origin = "; ".join(f"{k} ({_origin(k, v)})" for k, v in used.items())
    oks = [e["ok"] for file in results().values() for e in file["figures"].values()]
    missed, met = oks.count(False), oks.count(True)
    below = shared["below"].format(missed=missed, all=missed + met, origin=origin)
    return FENCES[0] + _table(rows) + below + FENCES[1]


def public_page() -> str:
    """Return the page of what public logs lacked: a paragraph per arm."""
    text, content = describe("public_logs"), results()["measured"]
    parts = [text["head"].strip().format(origin=_origin("measured", content))]
    masses = [m for split in content["splits"] for m in split["mass"]]
    for arm in text["arm"]:
        splits = [s for s in content["splits"] if s["split"].split()[0] == arm["key"]]
        lines = [f"- {_before_and_after(split)}" for split in splits]
        about = arm["text"].strip().format(mass=masses[0])
        command = f"```\n$ {arm['command']}\n```"
        parts += [f"## {arm['title']}", about, "\n".join(lines), command]
    return "\n\n".join(filter(None, parts)) + "\n"


def _before_and_after(split: Mapping) -> str:
    """Return the errors of one split: of all joints, and of the named ones."""
    stages = [split["moving"].get(k) for k in ("nominal", "identified", "augmented")]
    medians = [
        _number(statistics.median([x for x in errors if x is not None]))
        for errors in stages
        if errors
    ]
    before, after = stages[1] or stages[0], stages[2]
    joints = {joint for _, named in split["named"] for joint in named}
    changes = [
        f"J{j} {_number(before[j - 1])}→{_number(after[j - 1])}"
        for j in sorted(joints)
        if before[j - 1] is not None
    ]
    fitted, _, held_out = split["split"].partition(" ")[2].partition(" | ")
    logs = f"`{fitted}`, held out `{held_out}`" if held_out else f"`{fitted}`"
    overall = f"{'→'.join(medians)} %"
    return f"{logs}: {'; '.join([overall, *changes])}"


def _origin(name: str, content: Mapping) -> str:
    dirty = " with changes" if content["dirty"] else ""
    old = "" if is_current(name, content) else " **of older code**"
    seeds = f", seeds {content['seeds']}" if content.get("seeds") else ""
    return f"commit {content['commit'][:7]}{dirty}, {content['date'][:10]}{old}{seeds}"


def _table(rows: list[tuple[str, ...]]) -> str:
    rows = [rows[0], ("---",) * len(rows[0]), *rows[1:]]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _number(value: float) -> str:
    """Format to three significant digits; group the digits of large numbers."""
    if isinstance(value, int) or abs(value) >= 1000:
        digits = 0 if isinstance(value, int) else 2 - math.floor(math.log10(abs(value)))
        return f"{round(value, digits):,.0f}".replace(",", " ")
    return f"{value:.3g}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    PUBLIC.write_text(public_page(), encoding="utf-8")
    before, _, after = README.read_text(encoding="utf-8").partition(FENCES[0])
    README.write_text(before + readme_table() + after.partition(FENCES[1])[2], "utf-8")
