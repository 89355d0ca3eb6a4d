"""How often an effect was found, from the recorded results of the benchmarks.

Nothing here is measured anew: `benchmarks/results/*.json` name their commit and seeds.
"""

import json
from collections import Counter
from functools import cache
from pathlib import Path

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
FILES = ("diagnosis.json", "diagnosis_fresh.json")
RIGHT = ("right", "class")  # by its own name, or by an equivalent
NOT_MEASURED = "not measured"


@cache
def _read(name: str) -> dict:
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))


def rows(name: str) -> list[str]:
    """Return a Markdown row per recorded run and group of cases for one effect."""
    out = []
    for file in FILES:
        result = _read(file)
        made = f"{result['commit'][:7]}, {result['date'][:10]}"
        for group, what in (
            ("singles", "alone, three times its detectable size or more"),
            ("usual", "alone, at a usual size where no multiple could be drawn"),
            ("detection", "at exactly its detectable size (a half is expected)"),
        ):
            cases = _cases(result, group, name)
            if cases:
                right = sum(case["outcome"] in RIGHT for case in cases)
                told = f"{right} of {len(cases)} | {result['seeds']} | {made}"
                out.append(f"| {what} | {told} |")
    return out


def _cases(result: dict, group: str, name: str) -> list[dict]:
    if group == "detection":
        chosen = result["cases"].get("detection", ())
        return [case for case in chosen if case["effect"] == name]
    usual = group == "usual"
    return [
        case
        for case in result["cases"].get("singles", ())
        if case["effect"] == name and (case["multiple"] is None) == usual
    ]


def instead(name: str) -> Counter[str]:
    """Return what was named first in its place, where it was hidden alone."""
    return Counter(
        case["named_first"]
        for file in FILES
        for group in ("singles", "detection", "forms")
        for case in _read(file)["cases"].get(group, ())
        if case["effect"] == name and case["named_first"] not in (None, name)
    )


def page(name: str) -> str:
    """Return the section of an effect's page."""
    table = rows(name)
    if not table:
        return f"{NOT_MEASURED.capitalize()}: no recorded run has hidden it."
    head = "| hidden on a simulated arm | right | seeds | code |"
    return "\n".join([head, "| --- | --- | --- | --- |", *table])
