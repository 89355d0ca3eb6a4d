"""What a loop does next: a table of what it knows."""

import pytest

from flows.steps.closing.rule import (
    ADOPT,
    DIAGNOSE,
    DRIVE,
    NOTHING,
    SLOW,
    SPENT,
    STANDARD,
    STOP,
    UNDECIDED,
    Asked,
    next_step,
)
from tests.flows.closing.scripted import OFFSET, QUIET, SPRING, found
from warehouse.numbered import Decision

MANY = Asked(budget=20)


def history(*steps):
    """Decisions of (action, result), the ids of what they made by their number."""
    return [
        Decision("ab", i, "arm", "1", action, "why", "outcome", f"id{i}", 0.0, result)
        for i, (action, result) in enumerate(steps, 1)
    ]


def run(role="fit", designed=False, rivals=()):
    return "run", {"role": role, "designed": designed, "rivals": list(rivals)}


def looked(told, model=None):
    more = {"diagnosis": "d", "model": model, "unexplained": [2]}
    return DIAGNOSE, told | more


def adopted(*names):
    return ADOPT, {"adopted": True, "diagnosis": "m", "effects": list(names)}


FIRST = (run(), run("held out"))
ADOPTED = (*FIRST, looked(found(SPRING)), adopted(SPRING), (DRIVE, {}))
BOTH = found(SPRING, OFFSET)
NAMELESS = QUIET | {"verdict": "unknown"}
OPEN = found(SPRING, rivals=(SPRING, OFFSET))
DESIGNED = run(designed=True, rivals=(SPRING, OFFSET))
REFUSED = (ADOPT, {"adopted": False, "diagnosis": "d", "effects": [SPRING]})


NAMED, SEEN = looked(found(SPRING)), (*ADOPTED, run(), looked(found(OFFSET), "m"))
TWICE = (*ADOPTED, run(), looked(QUIET, "m"))
CALM = (*TWICE, run(), looked(QUIET, "m"))
APART = (*SEEN, looked(found(SPRING)))  # the other is not found without the model
UNSEEN = (*FIRST, NAMED, REFUSED, run("held out"))
BODY = found("payload on joint 6")
SETTLE = {"design": "d", "rivals": [SPRING, OFFSET]}
NEXT = [
    ((), "run", {"kind": STANDARD[0], "role": "fit"}),
    ((run(),), "run", {"role": "held out"}),
    (FIRST, DIAGNOSE, {"fit": ["id1"], "held_out": ["id2"], "model": None}),
    # Nothing found: one motion is not enough, two are.
    ((*FIRST, looked(QUIET)), "run", {"kind": STANDARD[1]}),
    ((*FIRST, run(), looked(QUIET)), STOP, {"why": NOTHING}),
    # A name: to the gate, then driven, then looked at again.
    ((*FIRST, NAMED), ADOPT, {"diagnosis": "d"}),
    ((*FIRST, NAMED, adopted(SPRING)), DRIVE, {"diagnosis": "m"}),
    (ADOPTED, "run", {"kind": STANDARD[1]}),
    ((*ADOPTED, run()), DIAGNOSE, {"fit": ["id6"], "model": "m"}),
    (TWICE, "run", {"kind": STANDARD[2]}),
    # Before the end all logs say together what a few since then may show too little of.
    (CALM, DIAGNOSE, {"fit": ["id1", "id6", "id8"], "model": None}),
    ((*CALM, looked(found(SPRING))), STOP, {"why": NOTHING}),
    ((*CALM, looked(BOTH)), ADOPT, {"diagnosis": "d"}),
    # What is found beside an adopted model has to hold by all logs together.
    (SEEN, DIAGNOSE, {"fit": ["id1", "id6"], "model": None}),
    ((*SEEN, looked(BOTH)), ADOPT, {"diagnosis": "d"}),
    # Or has to be found again beside it, with more motion.
    ((*APART, run(), looked(found(OFFSET), "m")), ADOPT, {"diagnosis": "d"}),
    ((*APART, run(), looked(BODY, "m")), DIAGNOSE, {"model": None}),
    (APART, "run", {"kind": STANDARD[2]}),
    # Rivals: a motion made for them, twice; then they are a class.
    ((*FIRST, looked(OPEN)), "run", SETTLE),
    ((*FIRST, looked(OPEN), DESIGNED, looked(OPEN)), "run", SETTLE),
    ((*FIRST, *2 * (looked(OPEN), DESIGNED), looked(OPEN)), ADOPT, {"diagnosis": "d"}),
    # Without a name nothing is adopted.
    ((*FIRST, looked(NAMELESS)), "run", {"kind": STANDARD[1]}),
    ((*FIRST, *4 * (run(),), looked(NAMELESS)), STOP, {"why": UNDECIDED}),
    # The gate goes by held-out motion, of which the first has no slow part.
    ((*FIRST, NAMED, REFUSED), "run", {"kind": SLOW, "role": "held out"}),
    (UNSEEN, DIAGNOSE, {"held_out": ["id2", "id5"], "model": None}),
    ((*CALM, looked(BOTH), REFUSED, run("held out")), DIAGNOSE, {"model": None}),
    ((*UNSEEN, NAMED, REFUSED), "run", {"kind": STANDARD[1], "role": "fit"}),
    ((*UNSEEN, *4 * (run(),), NAMED, REFUSED), STOP, {"why": UNDECIDED}),
]


@pytest.mark.parametrize(("done", "action", "how"), NEXT)
def test_what_is_known_says_what_comes_next(done, action, how):
    step = next_step(history(*done), MANY)
    assert step.action == action
    assert {key: step.how[key] for key in how} == how
    assert step.reason


def test_a_loop_that_has_ended_has_no_next_step():
    assert next_step(history(*FIRST, (STOP, {"why": NOTHING})), MANY) is None
    assert next_step(history(*FIRST, (STOP, {"why": UNDECIDED})), MANY) is None


def test_the_budget_ends_it_and_a_larger_one_goes_on():
    done = (*FIRST, looked(QUIET))
    step = next_step(history(*done), Asked(budget=2))
    assert (step.action, step.how["why"]) == (STOP, SPENT)
    ended = history(*done, (STOP, step.how))
    assert next_step(ended, Asked(budget=2)) is None
    assert next_step(ended, Asked(budget=3)).action == "run"


def test_rivals_that_the_budget_leaves_open_are_not_adopted():
    step = next_step(history(*FIRST, looked(OPEN)), Asked(budget=2))
    assert (step.action, step.how["why"]) == (STOP, SPENT)
    assert SPRING in step.reason


def test_in_a_fixed_order_nothing_is_designed():
    asked = Asked(budget=9, designed=False)
    step = next_step(history(*FIRST, looked(OPEN)), asked)
    assert step.how["kind"] == STANDARD[1]
    assert step.how["rivals"] == [SPRING, OFFSET]


def test_what_is_as_good_on_every_motion_is_said_with_what_is_adopted():
    told = found(SPRING, twins=("link_inertia on joint 3",))
    step = next_step(history(*FIRST, looked(told)), MANY)
    assert step.action == ADOPT
    assert "link_inertia on joint 3" in step.reason


def test_a_class_that_was_adopted_is_no_news_and_its_settled_name_is():
    wide = found(SPRING) | {"classes": [[SPRING, OFFSET]]}
    seen = (*ADOPTED, run(), looked(found(OFFSET), "m"))
    assert next_step(history(*seen, looked(wide)), MANY).action == "run"
    other = next_step(history(*seen, looked(found(OFFSET))), MANY)
    assert other.action == ADOPT
