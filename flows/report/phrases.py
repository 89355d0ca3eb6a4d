"""Effects, joints and lists in words, and the truth of a simulated experiment."""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from markupsafe import Markup

from residual import effects
from residual.effects.base import Effect
from residual.quantity import MISSING, format_percent, format_uncertain_value, is_number
from residual.verdict.result import Detectable, Finding, Place, Verdict

# Effects, joints and lists in words, for sentences and tables.

At = Place | Finding | Detectable  # what has a name and joints

_NUMBERS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight")
_UNKNOWN = Effect("", "", {}, columns=lambda state, joints, shape: state.tau_model)


@cache
def read_page_texts() -> dict[str, dict[str, Markup]]:
    """Return the fixed texts of pages, by page."""
    file = Path(__file__).parent / "templates" / "words.toml"
    parts = tomllib.loads(file.read_text(encoding="utf-8"))
    return {part: {k: Markup(v) for k, v in own.items()} for part, own in parts.items()}


def spell_number(value: int) -> str:
    """Return a small number in words: 6 becomes 'six'."""
    return _NUMBERS[value] if 0 <= value < len(_NUMBERS) else str(value)


def count_noun(count: int, noun: str) -> str:
    """Return how many there are: '1 run', '2 runs'."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def join_with_and(items: Sequence[str]) -> str:
    """Return 'a', 'a and b' or 'a, b and c'."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} and {items[-1]}"


def format_joints(joints: Iterable[int], dof: int | None = None) -> str:
    """Return joint numbers in words: 'joint 2', 'joints 4 to 6', 'all six joints', '' for none."""
    numbers = sorted(set(joints))
    if not numbers:
        return ""
    if len(numbers) == 1:
        return f"joint {numbers[0]}"
    if len(numbers) == dof:
        return "both joints" if dof == 2 else f"all {spell_number(len(numbers))} joints"
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    words = [
        word
        for run in runs
        for word in ([f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run))
    ]
    return f"joints {join_with_and(words)}"


def format_effect_noun(name: str) -> str:
    """Return an effect in words; a name that is not known loses its underscores."""
    if not name:
        return "an effect without a name"
    return find_effect(name).noun or str(name).replace("_", " ")


def find_effect(name: str | None) -> Effect:
    """Return the effect of that name; an empty one if it is unknown."""
    return (name and effects.find_effect(name)) or _UNKNOWN


def capitalize_first(text: str) -> str:
    """Return the text with its first letter raised, the rest as it is."""
    return text[:1].upper() + text[1:]


def format_effect_place(effect: At, dof: int | None = None) -> str:
    """Return an effect with its place: 'a balancer on joint 2'."""
    own, place = find_effect(effect.name), ""
    if own.scope == "flange":
        place = own.place
    elif effect.joints:
        words = format_joints(effect.joints, None if own.scope == "pair" else dof)
        place = own.place.format(joints=words, links=words.replace("joint", "link"))
    return f"{format_effect_noun(effect.name)} {place}".strip()


def format_equivalent_phrases(effect: Finding, dof: int | None = None) -> list[str]:
    """Return the equivalents in words; their place only where it differs."""
    words = []
    for other in effect.equivalent:
        same = other.joints == effect.joints
        same = same and "{joints}" in find_effect(other.name).place
        words.append(format_effect_noun(other.name) if same else format_effect_place(other, dof))
    return words


WEIGH_LOAD = "no motion separates them: weigh the load, or log the arm without it"


def is_link_or_load(finding: Finding) -> bool:
    """Whether a finding is a changed last link that a load explains as well."""
    others = [find_effect(other.name).carries for other in finding.equivalent]
    return find_effect(finding.name).replaces_link and {*others} == {"body"}


# The hidden effect of a simulated experiment, and the edit test.


def describe_edit_tests(verdict: Verdict) -> list[str]:
    """Return the baseline error after removing each effect, in sentences."""
    lines = []
    for edit in filter(lambda edit: is_number(edit.error), verdict.edit or ()):
        others = {
            "with it": edit.kept,
            "least squares": edit.least_squares,
            "baseline's own model": edit.reference,
        }
        listed = [f"{k} {format_percent(v)}" for k, v in others.items() if is_number(v)]
        lines.append(
            f"Edit test: without {format_effect_place(Place(edit.name, edit.joints))} "
            "the model predicts logs that never had it to "
            f"{format_percent(edit.error)} of torque"
            + (f" ({'; '.join(listed)})." if listed else ".")
        )
    return lines


@dataclass(frozen=True, slots=True)
class HiddenEffect:
    """One effect of the sealed half.

    Attributes:
        name: Its name.
        joints: Its joints as the verdict counts them, from 1.
        parameters: Value of each parameter, SI.
    """

    name: str
    joints: tuple[int, ...]
    parameters: Mapping[str, float]


def compare_with_truth(hidden: Sequence[HiddenEffect], verdict: Verdict) -> str:
    """Compare a verdict with the truth.

    Returns:
        "right": the first name is it. "class": it is an equivalent of the first name.
        "wrong", "missed"; where nothing was hidden "clean" or "false alarm".
    """
    if not hidden:
        return "false alarm" if verdict.effects else "clean"
    if not verdict.effects:
        return "missed"
    truth, first = {effect_joints_key(effect) for effect in hidden}, verdict.effects[0]
    if effect_joints_key(first) in truth:
        return "right"
    return "class" if truth & {*map(effect_joints_key, first.equivalent)} else "wrong"


def build_truth_rows(truth: Sequence[HiddenEffect], verdict: Verdict) -> list[tuple[str, str, str]]:
    """Return rows (quantity, hidden, named): the effect, then its parameters."""
    named, rows = verdict.effects, []
    for hidden in truth or (None,):
        same = [e for e in named if hidden and effect_joints_key(e) == effect_joints_key(hidden)]
        finding = next(iter([*same, *named]), None)
        pair = [format_effect_place(e) if e else "nothing" for e in (hidden, finding)]
        rows.append(("effect", *map(capitalize_first, pair)))
        units = find_effect(hidden.name).parameters if hidden else {}
        true = hidden.parameters if hidden else {}
        fitted = finding.parameters if finding else {}
        for key in dict.fromkeys([*fitted, *true]):
            unit = fitted[key].unit if key in fitted else units.get(key)
            value = format_uncertain_value(true.get(key), None, unit)
            rows.append((key.replace("_", " "), value, str(fitted.get(key, MISSING))))
    return rows


def effect_joints_key(effect: At | HiddenEffect) -> tuple[str, tuple[int, ...]]:
    """Return name and sorted joints, by which two places are the same."""
    return effect.name, tuple(sorted(effect.joints))
