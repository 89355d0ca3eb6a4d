"""Effects, joints and lists in words, for sentences and tables."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

from residual.diagnosis.result import Detectable, Finding, Place
from residual.effects import registry
from residual.effects.base import Effect

At = Place | Finding | Detectable  # what has a name and joints

_NUMBERS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight")
_UNKNOWN = Effect("", "", {}, columns=lambda state, joints, shape: state.tau_model)


def count(value: int) -> str:
    """Return a small number in words: 6 becomes 'six'."""
    return _NUMBERS[value] if 0 <= value < len(_NUMBERS) else str(value)


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
