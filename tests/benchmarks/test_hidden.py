"""What a verdict is worth beside the truth, case by case."""

import pytest

from benchmarks.hidden.score import Name, score
from tests.verdict_documents import typed


def entry(name, joints, order=1, alike=(), parameters=None):
    return {
        "name": name,
        "joints": list(joints),
        "order": order,
        "equivalent": [{"name": n, "joints": list(j)} for n, j in alike],
        "parameters": parameters or {"level": {"value": 1.0, "std": 0.1, "unit": ""}},
    }


def verdict(*effects, unexplained=()):
    nothing = "unknown" if unexplained else "none"
    part = {
        "verdict": "effects" if effects else nothing,
        "effects": list(effects),
        "unexplained": {"joints": list(unexplained)},
        "error": {"overall_filtered": {"nominal": 20.0, "identified": 8.0, "augmented": 4.4}},
    }
    return typed(part)


def verdict_in_words(words):
    """A verdict in words: names with joints, after | their rivals, after ? flags."""
    names, _, flags = words.partition("?")
    effects = []
    for order, name in enumerate(filter(None, names.split(";")), 1):
        first, *alike = ((n.split()[0], [int(n.split()[1])]) for n in name.split("|"))
        effects.append(entry(*first, order, alike=alike))
    return verdict(*effects, unexplained=[int(j) for j in flags.split()])


# What is drawn, the truth, the verdict; outcome, how many found, how many besides, and
# whether the joint is right.
JUDGED = [
    ("single", "stribeck 2", "stribeck 2", "right", 1, 0, True),
    ("single", "stribeck 2", "coulomb 2|stribeck 2", "class", 1, 0, True),
    ("single", "stribeck 2", "stribeck 3", "wrong", 0, 1, False),
    ("single", "stribeck 2", "offset 2", "wrong", 0, 1, True),
    ("single", "stribeck 2", "", "nothing", 0, 0, None),
    ("single", "stribeck 2", "?2", "flagged", 0, 0, True),
    ("single", "stribeck 2", "?5", "flagged", 0, 0, False),
    # The truth is named, but only second.
    ("single", "stribeck 2", "offset 3;stribeck 2", "wrong", 1, 1, False),
    # Friction of one more contact is Coulomb friction too, that yields: this must be
    # said, and of another joint it is false.
    ("single", "presliding 2", "presliding 2;coulomb 2", "right", 1, 0, True),
    ("single", "presliding 2", "coulomb 2", "wrong", 0, 1, True),
    ("single", "presliding 2", "presliding 2;coulomb 3", "right", 1, 1, True),
    ("pair", "stribeck 2;offset 3", "offset 3;stribeck 2", "right", 2, 0, True),
    ("pair", "stribeck 2;offset 3", "offset 3;spring 4", "part", 1, 1, True),
    ("none", "", "", "right", 0, 0, None),
    ("none", "", "?1", "flagged", 0, 0, None),
    ("none", "", "offset 3", "wrong", 0, 1, None),
    ("unknown", "x_wall 2", "?2", "flagged", 0, 0, True),
    ("unknown", "x_wall 2", "spring 2?2", "wrong", 0, 1, True),
]


@pytest.mark.parametrize(("drawn", "truth", "words", "outcome", "found", "extra", "joint"), JUDGED)
def test_a_verdict_beside_the_truth(drawn, truth, words, outcome, found, extra, joint):
    pairs = map(str.split, filter(None, truth.split(";")))
    judged = score(drawn, [Name(n, (int(j),)) for n, j in pairs], verdict_in_words(words))
    assert (judged.outcome, judged.count, judged.extra) == (outcome, found, extra)
    assert judged.joint_right is joint
