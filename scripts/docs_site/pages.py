"""The generated pages and tables of the site, as Markdown."""

import inspect
import json
import re
import sys
from collections import Counter, defaultdict
from functools import cache
from inspect import cleandoc, getdoc
from pathlib import Path

from cyclopts import Argument

import modelgap as mg
from flows.cli import GROUPS, app
from flows.report.phrases import capitalize_first
from residual.effects import load_effects
from residual.effects.base import EffectTrait
from scripts.docs_site import curve
from warehouse.sql_guard import NAMED, TAKES

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
FILES = ("diagnosis.json",)
RIGHT = ("right", "class")  # by its own name, or by an equivalent
NOT_MEASURED = "not measured"
EXAMPLE = ROOT / "examples" / "hidden"
FOLDER = "effects"
_WHERE = {
    "local": "one joint; its torque is on that joint alone",
    "pair": "two neighbouring joints that share gearing",
    "link": "one joint, and through the arm on the torque of all others",
    "flange": "the flange, reported at the last joint",
    "global": "the whole arm; reported without a joint",
}
_PLACE = {
    "local": "joint",
    "pair": "pair",
    "link": "link",
    "flange": "tool, last joint",
    "global": "all",
}
_WRONG_VALUE = (
    " Where the model has it already, a verdict means that its value is wrong, and the "
    "number is the change to it."
)


def generated() -> dict[str, str]:
    """Return every generated page by its place below docs/."""
    pages = {f"{FOLDER}/{name}.md": _effect(name) for name in load_effects()}
    return {
        **pages,
        "commands.md": commands_page(),
        "glossary.md": glossary_page(),
        "python.md": python_page(),
    }


def glossary_page() -> str:
    """Return the glossary of CONTRIBUTING.md as a page."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = re.search(r"^## (Glossary\n.*?)^By contributing", text, re.S | re.M)[1]
    return f"# {section}"


def python_page() -> str:
    """Return every public function and class with its signature and docstring."""
    return "# Signatures\n\n" + "\n\n".join(map(_public, mg.__all__)) + "\n"


def _public(name: str) -> str:
    subject = getattr(mg, name)
    about, _, more = (getdoc(subject) or "").partition("\n\n")
    parts = [f"## {name}", " ".join(about.split())]
    if inspect.isfunction(subject):
        call = f"mg.{name}({', '.join(_parameters(subject))})"
        parts.append(f"```python\n{call}\n```")
    if more:
        parts.append(f"```text\n{more}\n```")
    return "\n\n".join(parts)


def _parameters(function) -> list[str]:
    return [
        parameter.name
        if parameter.default is parameter.empty
        else f"{parameter.name}={parameter.default!r}"
        for parameter in inspect.signature(function).parameters.values()
    ]


def effects_table() -> str:
    """Return a row per effect: where it acts, its parameters and units."""
    rows = [
        f"| `{name}` | {effect.sentence} | {_PLACE[effect.scope]} | {_units(effect)} |"
        for name, effect in load_effects().items()
    ]
    head = "| name | the robot has | acts on | parameters [unit] |"
    return "\n".join([head, "| --- | --- | --- | --- |", *rows])


def _units(effect) -> str:
    keys: dict[str, list[str]] = defaultdict(list)
    for key, unit in effect.parameters.items():
        keys[unit].append(f"`{key}`")
    return ", ".join(f"{', '.join(names)} [{unit}]" for unit, names in keys.items())


def named_queries_table() -> str:
    """Return a row per named query of the store."""
    rows = [f"| `{name}` | {about} | {_values(name)} |" for name, (about, _) in NAMED.items()]
    return "\n".join(["| name | answer | takes |", "| --- | --- | --- |", *rows])


def _values(name: str) -> str:
    keys = TAKES.get(name, {})
    return ", ".join(f"`--with {key}=`: {about}" for key, about in keys.items())


# What stands in a page as <!-- generated: NAME -->.
TABLES = {"effects": effects_table, "named_queries": named_queries_table}


def llms_txt(nav: list, folder: Path) -> str:
    """Return the index of the pages for language models (llmstxt.org)."""
    lines = ["# modelgap", "", "> Names the effect that a robot's dynamic model lacks."]
    made = generated()
    for section in nav:
        for heading, entries in section.items():
            lines += ["", f"## {heading}", ""]
            for entry in entries:
                place = entry if isinstance(entry, str) else next(iter(entry.values()))
                text = made.get(place) or (folder / place).read_text(encoding="utf-8")
                title = re.search(r"^# (.*)", text, re.M)[1]
                lines.append(f"- [{title}]({place.removesuffix('.md')}.html)")
    return "\n".join(lines) + "\n"


def _effect(name: str) -> str:
    effect = load_effects()[name]
    units = "\n".join(f"- `{key}` [{unit}]" for key, unit in effect.parameters.items())
    # The text at the top of the file that the effect stands in.
    about = getdoc(sys.modules[f"residual.effects.{name}"]) or effect.sentence
    wrong = _WRONG_VALUE if EffectTrait.PARAMETER in effect.traits else ""
    law = "\n".join(f"    {line.strip()}" for line in effect.law.split(";"))
    caption = (
        "Its torque on made-up motion of the built-in arm, at a size whose largest torque is one."
    )
    drawn = (
        f'<figure class="effect">\n{curve.svg(effect)}\n'
        f"<figcaption>{caption}</figcaption>\n</figure>"
    )
    return "\n\n".join(
        [
            f"# {capitalize_first(effect.noun or name.replace('_', ' '))}",
            f"`{name}`: {effect.sentence}.",
            drawn,
            f"## Equation\n\n{law}",
            f"## Parameters\n\n{units}",
            f"It acts on {_WHERE[effect.scope]}.{wrong}",
            f"## What it is\n\n{about}",
            f"## What it is confused with\n\n{confused_with(name)}",
            f"## How often it is found\n\n{how_often_found(name)}",
            "What the rows mean, and all other figures: [what was measured](../benchmarks.md).",
            f"Its file: `residual/effects/{name}.py`.",
        ]
    )


def commands_page() -> str:
    """Return every command with all of its options, as Markdown."""
    parts = [
        "# Commands",
        "What `modelgap COMMAND --help` prints, in one place. Exit codes: 0 done, "
        "whatever was found; 1 the run failed; 2 bad usage or input; 130 interrupted.",
    ]
    for heading, group in GROUPS.items():
        parts.append(f"## {heading}")
        if word := group.get("word"):
            parts.append(f"{group['about']} They are listed by `modelgap {word}`.")
        parts += [_command_section(name) for name in group["commands"]]
    return "\n\n".join(parts) + "\n"


def option_words(name: str) -> dict[str, str]:
    """Return every word and option of a command as it is shown, with its meaning."""
    options = app[name].assemble_argument_collection(parse_docstring=True)
    return {
        _shown(one): " ".join((one.parameter.help or "").split()).replace("|", "\\|")
        for one in options
        if one.show
    }


def _shown(one: Argument) -> str:
    if not one.name.startswith("-"):
        many = "..." if one.is_var_positional() else ""
        return f"`{one.name}{many}`"
    usual = one.field_info.default
    told = usual not in (None, "", (), one.field_info.empty)
    default = f" (`{usual}`)" if told and not isinstance(usual, bool) else ""
    return f"`{one.name}`{default}"


def _command_section(name: str) -> str:
    about = cleandoc(app[name].help)
    rows = [f"| {shown} | {told} |" for shown, told in option_words(name).items()]
    table = "\n".join(["| word or option | what it is |", "| --- | --- |", *rows])
    return "\n\n".join([f"### {name}", about, *([table] if rows else [])])


@cache
def _read(name: str) -> dict:
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))


def recorded_rows(name: str) -> list[str]:
    """Return a Markdown row per recorded run and group of cases for one effect."""
    out = []
    for file in FILES:
        result = _read(file)
        made = f"{result['commit'][:7]}, {result['date'][:10]}"
        cases = defaultdict(list)
        for group in ("singles", "detection"):
            for case in result["cases"].get(group, ()):
                if case.get("effect") == name:
                    cases[_size(group, case)].append(case["outcome"] in RIGHT)
        for what in sorted(cases.keys() & set(_SIZES), key=_SIZES.index):
            told = f"{sum(cases[what])} of {len(cases[what])}"
            out.append(f"| {what} | {told} | {result['seeds']} | {made} |")
    return out


_SHARES = tuple(f"alone, {share:g} % of the joint's torque" for share in (10, 5, 2, 1))
_USUAL = "alone, at a usual size where no other could be drawn"
_DETECTABLE = "at exactly its detectable size (a half is expected)"
_SIZES = (*_SHARES, _USUAL, _DETECTABLE)


def _size(group: str, case: dict) -> str:
    """Return in words how large the effect of a case is."""
    if group == "detection":
        return _DETECTABLE
    share = case["share"]
    return f"alone, {100 * share:g} % of the joint's torque" if share else _USUAL


def named_instead(name: str) -> Counter[str]:
    """Return what was named first in its place, where it was hidden alone."""
    return Counter(
        case["named_first"]
        for file in FILES
        for group in ("singles", "detection", "forms")
        for case in _read(file)["cases"].get(group, ())
        if case["effect"] == name and case["named_first"] not in (None, name)
    )


def how_often_found(name: str) -> str:
    """Return the section of an effect's page."""
    table = recorded_rows(name)
    if not table:
        return f"{NOT_MEASURED.capitalize()}: no recorded run has hidden it."
    head = "| hidden on a simulated arm | right | seeds | code |"
    return "\n".join([head, "| --- | --- | --- | --- |", *table])


@cache
def _on_the_example() -> dict[str, tuple[int, Counter[str]]]:
    """By name: on how many joints it would show, and on how many not alone."""
    robot = mg.load_robot("irb140")
    fit = mg.read_logs([str(EXAMPLE / f"fit_{i}.csv") for i in (1, 2, 3)], robot)
    places: Counter[str] = Counter()
    others: dict[str, Counter[str]] = defaultdict(Counter)
    for one in mg.diagnose(robot, fit).verdict.minimum_detectable:
        places[one.name] += 1
        names = {other.name for other in one.confusable} - {one.name}
        others[one.name].update(sorted(names))
    return {name: (count, others[name]) for name, count in places.items()}


def confused_with(name: str) -> str:
    """Return the section of an effect's page."""
    return "\n\n".join(part for part in (_family(name), _example(name), _recorded(name)) if part)


def _family(name: str) -> str:
    family = load_effects()[name].family
    same = [n for n, e in load_effects().items() if e.family == family and n != name]
    if not family or not same:
        return ""
    return (
        f"On one joint only one of these is named, since small motion does not tell "
        f"them apart: {_links(same)}."
    )


def _example(name: str) -> str:
    count, others = _on_the_example().get(name, (0, Counter()))
    if not count:
        return (
            "The logs of `examples/hidden` were not asked about it: no size shows, "
            "or it is what they have."
        )
    if not others:
        return (
            "On the motion of `examples/hidden`, at three times its smallest "
            "detectable size, it is confused with nothing."
        )
    told = ", ".join(f"{_link(o)} ({n} of {count})" for o, n in others.most_common())
    return (
        "On the motion of `examples/hidden`, at three times its smallest detectable "
        f"size, these could not be told from it (on so many of the places where it may "
        f"sit): {told}."
    )


def _recorded(name: str) -> str:
    named = named_instead(name)
    if not named:
        return ""
    told = ", ".join(f"{_link(o)} {n} times" for o, n in named.most_common())
    return f"In the recorded runs below another name came first: {told}."


def _links(names) -> str:
    return ", ".join(map(_link, names))


def _link(name: str) -> str:
    return f"[{name}]({name}.md)"
