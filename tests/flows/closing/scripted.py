"""A loop whose arm is not moved: what comes of each step stands in a list."""

from flows.steps.closing import close
from flows.steps.closing.arm import Close
from flows.steps.closing.close import Came
from flows.steps.closing.rule import ADOPT, DIAGNOSE, RUN, STOP

SPRING, OFFSET = "spring on joint 3", "offset on joint 6"
QUIET = {"verdict": "none", "effects": [], "classes": [], "rivals": [], "twins": []}


def found(*names, rivals=(), twins=()):
    """What a diagnosis says that names these."""
    told = {"verdict": "effects", "effects": list(names), "rivals": list(rivals)}
    return told | {"classes": [[n] for n in names], "twins": list(twins)}


# Rivals that one motion tells apart, and nothing besides.
ONE = (found(SPRING),)
SCRIPT = (found(SPRING, rivals=(SPRING, OFFSET)), *ONE, QUIET, QUIET, *ONE)


def act(loop, step, tell=None, script=SCRIPT):
    """What comes of a step: a function of the step and of what was done before."""
    how = step.how
    if step.action == STOP:
        return Came("", None, how)
    made = f"{len(loop.history) + 1:020}"
    if step.action == RUN:
        length = {"length": 20.0, "family": how.get("kind", "designed")}
        result = {"role": how["role"], "rivals": list(how["rivals"])} | length
        return Came("moved", made, result | {"designed": "design" in how}, 20.0)
    before = sum(d.action == DIAGNOSE for d in loop.history)
    if step.action == DIAGNOSE:
        told = script[min(before, len(script) - 1)]
        about = {"diagnosis": made, "model": how["model"], "unexplained": [2]}
        return Came("looked", made, told | about)
    if step.action == ADOPT:
        names = script[before - 1]["effects"]
        told = {"adopted": True, "effects": names, "chain": [how["diagnosis"]]}
        told |= {"diagnosis": how["diagnosis"]}
        return Came("adopted", made, told)
    return Came("driven", made, {"before": 2.0, "after": 1.0})


def play(store, budget=6, **more):
    """Play the script to its end, from wherever a store has it."""
    asked = Close("irb140", budget, seed=1, effects=1, store=store, **more)
    return list(close.decisions(asked))
