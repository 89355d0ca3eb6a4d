"""Write two pages of docs/ and the table of the README from the results files.

    python benchmarks/page.py

benchmarks/words/ describes each figure; a figure without a description is an error.
"""

import math
import statistics
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.bench import PLAN, read
from benchmarks.harness.origin import ROOT, is_current

README, PAGE = ROOT / "README.md", ROOT / "docs" / "benchmarks.md"
PUBLIC = ROOT / "docs" / "guide" / "public_logs.md"
FENCES = "<!-- results -->\n", "<!-- end of results -->\n"


@dataclass(frozen=True)
class Figure:
    """One entry of a results file, and the unit that it is shown in."""

    entry: Mapping
    unit: str  # "share" and "count" of n cases, or a unit

    @property
    def value(self) -> float | None:
        """The measured value."""
        return self.entry["value"]

    @property
    def n(self) -> int:
        """Number of cases or repetitions."""
        return self.entry["n"]

    @property
    def hits(self) -> int:
        """Number of cases, from their number or their share."""
        value = self.value or 0
        return round(value * self.n) if isinstance(value, float) else value

    def __str__(self) -> str:
        if self.value is None:
            return "not measured"
        if self.unit == "count":
            return f"{_number(self.hits)} of {_number(self.n)}"
        if self.unit == "share":
            return f"{self.hits} of {self.n} ({_number(100 * self.hits / self.n)} %)"
        repeats = f" (n = {_number(self.n)})" if self.n > 1 else ""
        return f"{_number(self.value)} {self.unit}".strip() + repeats

    @property
    def bar(self) -> str:
        """The bar, and whether it is missed."""
        bar, entry = self.entry["bar"], self.entry
        if bar is None:
            return "–"
        percent = self.unit == "share" and isinstance(self.value, float)
        low, high = (
            f"{_number(100 * x)} %" if percent else _number(x)
            for x in (entry.get("low", bar), bar)
        )
        sign = "≥ " if entry.get("at_least") else "≤ "
        if self.value is None:  # the direction of the bar is not recorded
            sign = ""
        text = f"{low} to {high}" if "low" in entry else sign + high
        return text + {False: " **missed**", None: " *undecided*"}.get(entry["ok"], "")

    @property
    def interval(self) -> str:
        """The 95 % Wilson interval of a share, else empty."""
        if self.unit != "share" or "interval" not in self.entry:
            return ""
        return "{}–{} %".format(*(_number(100 * x) for x in self.entry["interval"]))


@cache
def descriptions() -> dict[str, dict]:
    texts = {
        path.stem: tomllib.loads(path.read_text(encoding="utf-8"))
        for path in (ROOT / "benchmarks" / "words").glob("*.toml")
    }
    for text in texts.values():
        # The value of each program on one case: a pattern of the key, and a title.
        text.setdefault("columns", {"{}": "value"})
    return texts


@cache
def results() -> dict[str, dict]:
    """Return the results files by name, in the order of the plan."""
    return {name: content for name in PLAN if (content := read(name))}


def figures(name: str, content: Mapping) -> dict[str, tuple[str, Figure]]:
    """Return all figures of a results file with their descriptions."""
    text = descriptions()[name]
    return {
        full: (entry["is"], Figure(content["figures"][full], entry["unit"]))
        for key, entry in text["figures"].items()
        for full in dict.fromkeys([*_keys(text, key), key])
        if full in content["figures"]
    }


def _keys(text: Mapping, key: str) -> list[str]:
    """Return the names of one figure of each program."""
    return [pattern.format(key) for pattern in text["columns"]]


def page() -> str:
    sections = [_section(name, content) for name, content in results().items()]
    machines = dict.fromkeys(
        f"{content['cores']} cores ({content['machine']}), Python {content['python']}"
        for content in results().values()
    )
    head = descriptions()["page"]["head"].format(machines="; ".join(machines))
    return "\n".join(
        [head.lstrip(), *sections, descriptions()["page"]["worse"].lstrip()]
    )


def readme_table() -> str:
    """Return the table of results of the README, between its two comments."""
    every = {name: figures(name, content) for name, content in results().items()}
    shared, used = descriptions()["page"], {}
    rows = [("tested on", "counted", "result", "bar"), ("---",) * 4]
    for row in shared["readme"]:
        file, key = row["figure"].split(".")
        used[file] = results()[file]
        shown = every[file][key][1]
        rows.append((row["on"], row["counted"], str(shown), shown.bar))
    origin = "; ".join(f"{k} ({_origin(k, v)})" for k, v in used.items())
    oks = [f.entry["ok"] for file in every.values() for _, f in file.values()]
    missed, met = oks.count(False), oks.count(True)
    below = shared["below"].format(missed=missed, all=missed + met, origin=origin)
    return FENCES[0] + _table(rows) + below + FENCES[1]


def main() -> int:
    PAGE.write_text(page(), encoding="utf-8")
    PUBLIC.write_text(public_page(), encoding="utf-8")
    before, _, after = README.read_text(encoding="utf-8").partition(FENCES[0])
    README.write_text(before + readme_table() + after.partition(FENCES[1])[2], "utf-8")
    return 0


def _section(name: str, content: Mapping) -> str:
    text, entries = descriptions()[name], figures(name, content)
    titles = tuple(text["columns"].values())
    rows = [("what", *titles, "bar", "95 %"), ("---",) * (len(titles) + 3)]
    for key, entry in text["figures"].items():
        keys = _keys(text, key)
        shown = [k for k in (*keys, key) if k in entries]
        if shown:
            cells = [str(entries[k][1]) if k in entries else "" for k in keys]
            figure = entries[shown[0]][1]
            if shown == [key]:  # of no program
                cells[0] = str(figure)
            rows.append((entry["is"], *cells, figure.bar, figure.interval))
    facts = f"`results/{name}.json`: {_origin(name, content)}"
    parts = [f"## {text['title']}", facts, text["about"].strip(), _table(rows).rstrip()]
    return "\n\n".join(filter(None, parts)) + "\n"


def public_page() -> str:
    """Return the page of what public logs lacked: a paragraph per arm."""
    text, content = descriptions()["public_logs"], results()["measured"]
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
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _number(value: float) -> str:
    """Format to three significant digits; group the digits of large numbers."""
    if isinstance(value, int) or abs(value) >= 1000:
        digits = 0 if isinstance(value, int) else 2 - math.floor(math.log10(abs(value)))
        return f"{round(value, digits):,.0f}".replace(",", " ")
    return f"{value:.3g}"


if __name__ == "__main__":
    sys.exit(main())
