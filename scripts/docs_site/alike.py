"""What an effect is confused with: on the example's logs, and in recorded runs."""

from collections import Counter, defaultdict
from functools import cache
from pathlib import Path

import modelgap as mg
from residual.effects import registry
from scripts.docs_site import found

EXAMPLE = Path(__file__).parents[2] / "examples" / "hidden"


@cache
def _on_the_example() -> dict[str, tuple[int, Counter[str]]]:
    """By name: on how many joints it would show, and on how many not alone."""
    robot = mg.load_robot("irb140")
    fit = mg.read_logs([str(EXAMPLE / f"fit_{i}.csv") for i in (1, 2, 3)], robot)
    places: Counter[str] = Counter()
    others: dict[str, Counter[str]] = defaultdict(Counter)
    for one in mg.diagnose(robot, fit).verdict.minimum_detectable:
        places[one.name] += 1
        others[one.name].update({other.name for other in one.confusable} - {one.name})
    return {name: (count, others[name]) for name, count in places.items()}


def page(name: str) -> str:
    """Return the section of an effect's page."""
    return "\n\n".join(
        part for part in (_family(name), _example(name), _recorded(name)) if part
    )


def _family(name: str) -> str:
    family = registry()[name].family
    same = [n for n, e in registry().items() if e.family == family and n != name]
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
    named = found.instead(name)
    if not named:
        return ""
    told = ", ".join(f"{_link(o)} {n} times" for o, n in named.most_common())
    return f"In the recorded runs below another name came first: {told}."


def _links(names) -> str:
    return ", ".join(map(_link, names))


def _link(name: str) -> str:
    return f"[{name}]({name}.md)"
