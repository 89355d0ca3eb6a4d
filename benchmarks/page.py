"""Write the pages of benchmarks and the README's table from the results files.

    python benchmarks/page.py

What a figure means stands in benchmarks/words/; a figure without words is an error.
"""

import json
import math
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.bench import PLAN
from benchmarks.harness.origin import RESULTS, ROOT, is_current

README = ROOT / "README.md"
# By the `page` that the words of a results file ask for; "" where they ask for none.
PAGES = {
    "": ROOT / "docs" / "benchmarks.md",
    "tools": ROOT / "docs" / "benchmarks_tools.md",
    "used": ROOT / "docs" / "benchmarks_used.md",
    "loop": ROOT / "docs" / "benchmarks_loop.md",
    "fleet": ROOT / "docs" / "benchmarks_fleet.md",
    "peers": ROOT / "docs" / "benchmarks_peers.md",
}
FENCES = "<!-- results -->\n", "<!-- end of results -->\n"
_WORDS = {
    path.stem: tomllib.loads(path.read_text(encoding="utf-8"))
    for path in (ROOT / "benchmarks" / "words").glob("*.toml")
}
# Where several programs have the same figures, their words stand once.
for _one in _WORDS.values():
    _each = {
        f"{program}_{key}": entry | {"is": f"{title}: {entry['is']}"}
        for program, title in _one.get("programs", {}).items()
        for key, entry in _one["of_each"].items()
    }
    _one["figures"] = _each | _one.get("figures", {})
_SHARED = _WORDS.pop("page")


@dataclass(frozen=True)
class Figure:
    """One entry of a results file, and the unit that it is shown in."""

    entry: Mapping
    unit: str

    @property
    def value(self) -> float | None:
        """What was measured."""
        return self.entry["value"]

    @property
    def n(self) -> int:
        """Cases or repetitions."""
        return self.entry["n"]

    @property
    def hits(self) -> int:
        """Cases, whether the file has their number or their share."""
        value = self.value or 0
        return round(value * self.n) if isinstance(value, float) else value

    def __str__(self) -> str:
        if self.value is None:
            return "not measured"
        if self.unit == "count":
            return f"{_number(self.hits)} of {_number(self.n)}"
        if self.unit == "share":
            return f"{self.hits} of {self.n} ({_number(100 * self.hits / self.n)} %)"
        return f"{_number(self.value)} {self.unit}".strip()

    @property
    def bar(self) -> str:
        """The bar, and whether it was missed."""
        bar, entry = self.entry["bar"], self.entry
        if bar is None:
            return "–"
        percent = self.unit == "share" and isinstance(self.value, float)
        low, high = (
            f"{_number(100 * x)} %" if percent else f"{_number(x)}"
            for x in (entry.get("low", bar), bar)
        )
        sign = "≥ " if entry.get("at_least") else "≤ "
        if self.value is None:  # then nobody wrote down which way it goes
            sign = ""
        words = f"{low} to {high}" if "low" in entry else sign + high
        return words + {False: " **missed**", None: " –"}.get(entry["ok"], "")

    @property
    def interval(self) -> str:
        """Where the rate lies with 95 % (Wilson); "" of what is no rate."""
        if self.unit != "share" or "interval" not in self.entry:
            return ""
        return "{} to {} %".format(*(_number(100 * x) for x in self.entry["interval"]))


@cache
def results() -> dict[str, dict]:
    """Return the results files by name, in the order of the page."""
    files = {p.stem: json.loads(p.read_text("utf-8")) for p in RESULTS.glob("*.json")}
    known = {name: files.pop(name) for name in _SHARED["order"] if name in files}
    return known | files


def figures(name: str, content: Mapping) -> dict[str, tuple[str, Figure]]:
    """Return words and figure of each entry of a results file."""
    words = _WORDS[name]["figures"]
    ordered = sorted(content["figures"], key=list(words).index)
    return {
        key: (words[key]["is"], Figure(content["figures"][key], words[key]["unit"]))
        for key in ordered
    }


def page(which: str = "") -> str:
    """Return the text of one of the PAGES."""
    own = [
        item for item in results().items() if _WORDS[item[0]].get("page", "") == which
    ]
    head = _SHARED["heads"][which or "all"].lstrip()
    return "\n".join([head, *(_section(*item) for item in own)])


def readme_table() -> str:
    """Return the table of results of the README, between its two comments."""
    every = {
        name: SimpleNamespace(**{k: f for k, (_, f) in figures(name, content).items()})
        for name, content in results().items()
    }
    rows = [("tested on", "what came out", "wanted"), ("---", "---", "---")]
    for row in _SHARED["readme"]:
        found = (key.split(".") for key in row["bars"])
        bars = "; ".join(getattr(every[file], key).bar for file, key in found)
        rows.append((row["on"], row["figure"].format(**every), bars))
    used = {key.split(".")[0] for row in _SHARED["readme"] for key in row["bars"]}
    from_ = [f"{k} ({_origin(k, v)})" for k, v in results().items() if k in used]
    oks = [f.entry["ok"] for file in every.values() for f in vars(file).values()]
    missed, met = oks.count(False), oks.count(True)
    below = _SHARED["below"].format(
        missed=missed, all=missed + met, origin="; ".join(from_)
    )
    return FENCES[0] + _table(rows) + below + FENCES[1]


def main() -> int:
    # Tests and bench.py read pages, and need no Matplotlib for it.
    from benchmarks.changes_parts.picture import draw

    for which, path in PAGES.items():
        path.write_text(page(which), encoding="utf-8")
    draw(results()["changes"]["cases"], ROOT / "docs" / "img" / "power.png")
    before, _, rest = README.read_text(encoding="utf-8").partition(FENCES[0])
    README.write_text(before + readme_table() + rest.partition(FENCES[1])[2], "utf-8")
    return 0


def _section(name: str, content: Mapping) -> str:
    words = _WORDS[name]
    rows = [("what", "value", "n", "bar", "95 %"), ("---", "---", "---:", "---", "---")]
    for is_, entry in figures(name, content).values():
        rows.append((is_, str(entry), _number(entry.n), entry.bar, entry.interval))
    facts = f"`{RESULTS.name}/{name}.json`: {_origin(name, content)}"
    facts += f", {content['cores']} cores"
    facts += f" ({content['machine']})" if "machine" in content else ""
    command = " ".join(word for word in PLAN[name] if word != "--resume")
    place = f"benchmarks/results/{name}.json"
    facts += f", Python {content['python']}; `python {command} --full-json {place}`"
    facts += f"\\\n{words['about'].strip()}"  # a backslash breaks the line
    parts = [f"## {words['title']}", facts, content.get("note")]
    parts += [_table(rows).rstrip(), _arms(content.get("measured", ()))]
    parts += [_titled(table) for table in content.get("tables", ())]
    return "\n\n".join(part for part in parts if part) + "\n"


def _titled(table: Mapping) -> str:
    """A table that the benchmark itself has put together."""
    head, *rows = map(tuple, table["rows"])
    lines = [head, ("---",) * len(head), *rows]
    return f"### {table['title']}\n\n{_table(lines).rstrip()}"


def _arms(measured: list[Mapping]) -> str:
    """The measured arms one by one, where least squares stand beside them."""
    rows = [("fitted / held out", "named", "error over least squares, per joint")]
    rows.append(("---", "---", "---"))
    for arm in measured:
        if "peer" not in arm:
            return ""
        named = "; ".join(f"{name} on {_plain(on)}" for name, on in arm["named"])
        ratios = "–"
        if arm["peer"]:
            pairs = zip(arm["filtered"]["augmented"], arm["peer"], strict=True)
            ratios = ", ".join(f"{ours / peer:.2f}" for ours, peer in pairs)
        rows.append((arm["split"].replace("|", "/"), named or arm["verdict"], ratios))
    return _table(rows).rstrip() if measured else ""


def _origin(name: str, content: Mapping) -> str:
    seeds = f", seeds {content['seeds']}" if content.get("seeds") else ""
    runs: dict[str, list[str]] = {}
    for group, run in content.get("by_group", {}).items():
        runs.setdefault(_of_run(name, run), []).append(group)
    if len(runs) > 1:  # each group has the circumstances of the run that it is from
        return "; ".join(f"{', '.join(own)}: {run}" for run, own in runs.items())
    return "".join(runs or [_of_run(name, content)]) + seeds


def _of_run(name: str, run: Mapping) -> str:
    dirty = " with changes" if run["dirty"] else ""
    # Said by the page itself: a reader cannot know when the method changed.
    old = "" if is_current(name, run) else " **of older code**"
    return f"commit {run['commit'][:7]}{dirty}, {run['date'][:10]}{old}"


def _table(rows: list[tuple[str, ...]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _plain(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_plain(v)}" for k, v in value.items())
    if isinstance(value, list):
        return ", ".join(map(_plain, value))
    return _number(value) if isinstance(value, int | float) else str(value)


def _number(value: float) -> str:
    """Three digits that count; large numbers in groups."""
    if isinstance(value, int) or abs(value) >= 1000:
        digits = 0 if isinstance(value, int) else 2 - math.floor(math.log10(abs(value)))
        return f"{round(value, digits):,.0f}".replace(",", " ")
    return f"{value:.3g}"


if __name__ == "__main__":
    sys.exit(main())
