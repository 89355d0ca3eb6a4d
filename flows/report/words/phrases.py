"""Effects, joints and lists in words, and what only experiments of our own show."""

import base64
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

from markupsafe import Markup

from residual.diagnosis.result import Detectable, Edit, Finding, Place, Verdict
from residual.effects import registry
from residual.effects.base import Effect
from residual.quantity import MISSING, known, measured, percent

# Effects, joints and lists in words, for sentences and tables.

At = Place | Finding | Detectable  # what has a name and joints

_NUMBERS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight")
_UNKNOWN = Effect("", "", {}, columns=lambda state, joints, shape: state.tau_model)


@cache
def texts() -> dict[str, dict[str, Markup]]:
    """Return what pages say that hangs on no figure, page by page."""
    file = Path(__file__).parents[1] / "templates" / "words.toml"
    parts = tomllib.loads(file.read_text(encoding="utf-8"))
    return {part: {k: Markup(v) for k, v in own.items()} for part, own in parts.items()}


def count(value: int) -> str:
    """Return a small number in words: 6 becomes 'six'."""
    return _NUMBERS[value] if 0 <= value < len(_NUMBERS) else str(value)


def many(count: int, noun: str) -> str:
    """Return how many there are: '1 run', '2 runs'."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def listing(items: Sequence[str]) -> str:
    """Return 'a', 'a and b' or 'a, b and c'."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} and {items[-1]}"


def joint_words(joints: Iterable[int], dof: int | None = None) -> str:
    """Return joints in words: 'joint 2', 'joints 4 to 6', 'all six joints'.

    Args:
        joints: Joint numbers from 1.

    Returns:
        Words without a preposition; empty without joints.
    """
    numbers = sorted(set(joints))
    if not numbers:
        return ""
    if len(numbers) == 1:
        return f"joint {numbers[0]}"
    if len(numbers) == dof:
        return "both joints" if dof == 2 else f"all {count(len(numbers))} joints"
    return f"joints {listing(_runs(numbers))}"


def _runs(numbers: list[int]) -> list[str]:
    """Return numbers as text, three or more in a row drawn together."""
    groups = [[numbers[0]]]
    for last, value in pairwise(numbers):
        if value == last + 1:
            groups[-1].append(value)
        else:
            groups.append([value])
    words = []
    for group in groups:
        short = len(group) < 3
        words += map(str, group) if short else [f"{group[0]} to {group[-1]}"]
    return words


def noun(name: str) -> str:
    """Return an effect in words; a name that is not known loses its underscores."""
    if not name:
        return "an effect without a name"
    return effect_named(name).noun or str(name).replace("_", " ")


def effect_named(name: str | None) -> Effect:
    """Return the effect of that name; one without words where nobody knows it."""
    return registry().get(name) or _UNKNOWN


def sentence_case(text: str) -> str:
    """Return the text with its first letter raised, the rest as it is."""
    return text[:1].upper() + text[1:]


def place(effect: At, dof: int | None = None) -> str:
    """Return where an effect sits, with its preposition: 'on joint 2'."""
    joints, own = effect.joints, effect_named(effect.name)
    if own.scope == "flange":
        return own.place
    if not joints:
        return ""
    words = joint_words(joints, None if own.scope == "pair" else dof)
    return own.place.format(joints=words, links=words.replace("joint", "link"))


def kind(name: str) -> str:
    """Return an effect in words without its joint: 'a spring', 'inertia of a link'."""
    own = effect_named(name)
    if own.place.startswith("of "):
        where = own.place.format(joints="a joint", links="a link")
        return f"{noun(name).removeprefix('the ')} {where}"
    return noun(name)


def phrase(effect: At, dof: int | None = None) -> str:
    """Return an effect with its place: 'a balancer on joint 2'."""
    return f"{noun(effect.name)} {place(effect, dof)}".strip()


def alternatives(effect: Finding, dof: int | None = None) -> list[str]:
    """Return the equivalents in words; their place only where it differs."""
    words = []
    for other in effect.equivalent:
        same = other.joints == effect.joints
        same = same and "{joints}" in effect_named(other.name).place
        words.append(noun(other.name) if same else phrase(other, dof))
    return words


# The edit test, and what only a simulated experiment can show: the truth.


def edit_sentence(edit: Edit) -> str:
    """Return what is left of one effect that was taken out of the model again."""
    effect = phrase(Place(edit.name, edit.joints))
    words = f"{effect}, taken out again: error {percent(edit.error)} of torque"
    parts = {
        "with it": edit.kept,
        "least squares": edit.least_squares,
        "with the baseline's own parameters": edit.reference,
    }
    words += "".join(f"; {k} {percent(v)}" for k, v in parts.items() if known(v))
    return sentence_case(f"{words}.")


def baseline_sentences(verdict: Verdict) -> list[str]:
    """Return what is left on the baseline of each effect of a verdict, by name."""
    return [edit_sentence(edit) for edit in verdict.edit or () if known(edit.error)]


_JUDGED = {
    "right": "the first name is what was hidden",
    "class": "what was hidden is among the effects that these logs cannot tell apart",
    "wrong": "the first name is not what was hidden",
    "missed": "something was hidden and nothing was named",
    "clean": "nothing was hidden and nothing was named",
    "false alarm": "nothing was hidden and something was named",
}

# On purpose: a diagnosis that shared the arm's formulas would confirm itself.
FORMS = (
    "The arm's laws are written otherwise than the diagnosis's (a hose softens, a "
    "textbook spring does not). Standard deviations assume the named form, so a size "
    "may be off by more."
)


@dataclass(frozen=True, slots=True)
class Hidden:
    """One effect that was under the seal.

    Attributes:
        name: Its name.
        joints: Its joints as the verdict counts them, from 1.
        parameters: Value of each parameter, SI.
    """

    name: str
    joints: tuple[int, ...]
    parameters: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Staged:
    """What the report of a staged experiment has beyond any other.

    Attributes:
        gif: The arm in motion; empty for no picture.
        caption: What the picture shows.
        hidden: What was under the seal.
        verdict: The verdict that was stored before the seal was opened.
    """

    gif: bytes
    caption: str
    hidden: tuple[Hidden, ...]
    verdict: Verdict

    @property
    def uri(self) -> str:
        """The picture as a data address."""
        return "data:image/gif;base64," + base64.b64encode(self.gif).decode()

    @property
    def judged(self) -> str:
        """In a sentence, how verdict and truth compare."""
        return sentence_case(_JUDGED[judge(self.hidden, self.verdict)]) + "."

    @property
    def forms(self) -> str:
        """Why sizes need not agree; empty where nothing was found."""
        return FORMS if self.hidden and self.verdict.effects else ""

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Rows (what, hidden, found): the effect, then its parameters."""
        found = self.verdict.effects
        first = found[0] if found else None
        rows = []
        for hidden in self.hidden or (None,):
            match = _same(hidden, found) or first
            rows += _rows(hidden, match)
        return rows


def judge(hidden: Sequence[Hidden], verdict: Verdict) -> str:
    """Compare a verdict with the truth.

    Args:
        hidden: What was under the seal; one effect, or none.

    Returns:
        "right": the first name is it. "class": it is an equivalent of the first name.
        "wrong", "missed"; where nothing was hidden "clean" or "false alarm".
    """
    found = verdict.effects
    if not hidden:
        return "false alarm" if found else "clean"
    if not found:
        return "missed"
    truth = {_key(one.name, one.joints) for one in hidden}
    first = found[0]
    if _key(first.name, first.joints) in truth:
        return "right"
    others = {_key(e.name, e.joints) for e in first.equivalent}
    return "class" if others & truth else "wrong"


def _rows(hidden: Hidden | None, found: Finding | None) -> list[tuple[str, str, str]]:
    there = Place(hidden.name, hidden.joints) if hidden else None
    named = [phrase(e) if e else "nothing" for e in (there, found)]
    rows = [("effect", *map(sentence_case, named))]
    units = effect_named(hidden.name).parameters if hidden else {}
    true = dict(hidden.parameters) if hidden else {}
    theirs = found.parameters if found else {}
    for key in dict.fromkeys([*theirs, *true]):
        own = theirs.get(key)
        value = measured(true.get(key), None, own.unit if own else units.get(key))
        rows.append((key.replace("_", " "), value, str(own) if own else MISSING))
    return rows


def _same(hidden: Hidden | None, found: Sequence[Finding]) -> Finding | None:
    if hidden is None:
        return None
    key = _key(hidden.name, hidden.joints)
    return next((e for e in found if _key(e.name, e.joints) == key), None)


def _key(name: str, joints: Iterable[int]) -> tuple[str, tuple[int, ...]]:
    return name, tuple(sorted(joints))
