"""What a loop does next, given what it has done: a pure function of its records.

Nothing is read and nothing is run here, so every case of it is a row of a table in the
tests, and a loop that was killed decides as it would have decided.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from warehouse.numbered import Decision

RUN = "run"


@dataclass(frozen=True, eq=False, slots=True)
class Known:
    """The records of a loop, sorted.

    Attributes:
        last: The last one, None at the beginning.
        runs: Every experiment, the first one first.
        adopted: What the last adoption left (`diagnosis`, `effects`), None for none.
        since: Ids of the experiments to fit that came after it.
        later: The experiments after it.
        looks: What every diagnosis after it said.
    """

    last: Decision | None
    runs: tuple[Decision, ...]
    adopted: Mapping | None
    since: tuple[str, ...]
    later: tuple[Decision, ...]
    looks: tuple[Mapping, ...]

    @classmethod
    def of(cls, history: Sequence[Decision]) -> "Known":
        """Sort the records of a loop."""
        runs = tuple(d for d in history if d.action == RUN)
        given = [d for d in history if d.action == "adopt" and d.result["adopted"]]
        begun = given[-1].number if given else 0
        later = tuple(d for d in runs if d.number > begun)
        return cls(
            last=history[-1] if history else None,
            runs=runs,
            adopted=given[-1].result if given else None,
            since=_fitted(later),
            later=later,
            looks=tuple(
                d.result for d in history if d.action == "diagnose" and d.number > begun
            ),
        )

    @property
    def fit(self) -> tuple[str, ...]:
        """Ids of all experiments to fit."""
        return _fitted(self.runs)

    @property
    def held_out(self) -> tuple[str, ...]:
        """Ids of those that no fit sees."""
        return tuple(d.made for d in self.runs if d.result["role"] != "fit")

    @property
    def standard(self) -> int:
        """How many of the standard motions to fit were run."""
        own = (d for d in self.runs if d.result["role"] == "fit")
        return sum(not d.result["designed"] for d in own)

    def tried(self, rivals: Sequence[str]) -> int:
        """How many experiments since the last adoption were for these rivals."""
        wanted = sorted(rivals)
        return sum(sorted(d.result["rivals"]) == wanted for d in self.later)


def _fitted(runs: Sequence[Decision]) -> tuple[str, ...]:
    return tuple(d.made for d in runs if d.result["role"] == "fit")


DIAGNOSE, ADOPT, DRIVE, STOP = "diagnose", "adopt", "drive", "stop"
# Why a loop ends; the first is the only one that more experiments would change.
SPENT, NOTHING, UNDECIDED = "budget", "nothing left", "undecided"

FIT, HELD_OUT = "fit", "held out"
# What is run where nothing better is known: fast and slow, reversing and standing. The
# others pass low speeds at reversals alone, of which friction at standstill masks all:
# what friction does below a tenth of a radian per second shows in the slow one only.
SLOW = "slow_cyclic"
STANDARD = ("fourier", SLOW, "move_stop_move", "cyclic", "welding")
PROOF = "cyclic"  # the family of the motion that no fit sees
CLEAN = 2  # motions without a finding after which nothing is left
TRIES = 2  # designed motions for one question


@dataclass(frozen=True, slots=True)
class Asked:
    """How a loop is to go on.

    Attributes:
        budget: How many experiments it may run.
        designed: Whether what is open is settled by a designed motion; else the
            standard ones follow in their order, whatever is open.
    """

    budget: int
    designed: bool = True


@dataclass(frozen=True, slots=True)
class Step:
    """What is to be done next.

    Attributes:
        action: run, diagnose, adopt, drive or stop.
        reason: Why, in a sentence.
        how: What with, as JSON can hold it.
    """

    action: str
    reason: str
    how: Mapping = field(default_factory=dict)


def next_step(history: Sequence[Decision], asked: Asked) -> Step | None:
    """Return what a loop does next; None where it has ended."""
    known = Known.of(history)
    last = known.last
    if last is None:
        return _run(STANDARD[0], FIT, "nothing is known of this arm yet")
    if last.action == STOP:
        more = last.result["why"] == SPENT and len(known.runs) < asked.budget
        return _more(known, asked, "more experiments are allowed now") if more else None
    if not known.held_out:
        return _run(PROOF, HELD_OUT, "no name counts without motion that no fit saw")
    if last.action == RUN:
        return _look(known)
    if last.action == DIAGNOSE:
        return _judge(known, last.result, asked)
    if last.action == ADOPT:
        return _answered(known, asked)
    return _more(known, asked, "is anything left above noise, now that it is adopted?")


def _answered(known: Known, asked: Asked) -> Step:
    """Drive by what was adopted; where the gate refused it, show the gate more."""
    last = known.last
    if last.result["adopted"]:
        why = "does the arm follow its path better with what was adopted?"
        return Step(DRIVE, why, {"diagnosis": known.adopted["diagnosis"]})
    why = f"the gate refused it: {last.outcome}"
    if len(known.held_out) > 1 or len(known.runs) >= asked.budget:
        return _doubt(known, asked, why)
    return _run(SLOW, HELD_OUT, f"{why}; a slow motion may show what it could not")


def _look(known: Known) -> Step:
    """Diagnose: all logs at first, and the new ones once a model is adopted."""
    if known.adopted is None:
        why = "what does the model as described lack, by all logs so far?"
        return _whole(known, why)
    if known.last.result["role"] != FIT:
        return _whole(known, "does the new held-out motion bear it out?")
    why = "what does the adopted model lack, by the logs since it was adopted?"
    return _diagnose(known.since, known.held_out, known.adopted["diagnosis"], why)


def _judge(known: Known, found: Mapping, asked: Asked) -> Step:
    """What a diagnosis asks for."""
    if found["verdict"] == "none":
        return _clean(known, found, asked)
    if found["model"] is not None and _again(known, found):
        return _open(known, found, asked) or _settled(found)
    if found["model"] is not None:
        why = (
            f"{_said(found)} beside the adopted model: all logs together, from the "
            "model as described, say whether that holds"
        )
        return _whole(known, why)
    if found["verdict"] == "unknown":
        return _open(known, found, asked) or _doubt(known, asked, _said(found))
    if known.adopted and _same(known.adopted["effects"], found["classes"]):
        why = "all logs together name just what is adopted, and nothing new"
        return _nothing(known, why) if _quiet(known) else _doubt(known, asked, why)
    return _open(known, found, asked) or _settled(found)


def _clean(known: Known, found: Mapping, asked: Asked) -> Step:
    """Nothing was found: enough of that is the end."""
    if known.adopted and found["model"] is None:
        why = "all logs together name nothing, although something was adopted"
        return _doubt(known, asked, why)
    if len(known.since) < CLEAN:
        why = "nothing found on one motion: another family shows other effects"
        return _more(known, asked, why)
    if known.adopted:
        why = "nothing is left beside the adopted model; what do all logs together say?"
        return _whole(known, why)
    return _nothing(known, "nothing is left above noise beside the model as described")


def _nothing(known: Known, why: str) -> Step:
    return Step(STOP, f"{why}, on {len(known.since)} motions", {"why": NOTHING})


def _quiet(known: Known) -> bool:
    """Whether nothing was left beside the adopted model, before all logs were asked.

    A few motions since may show too little of what the many before add to.
    """
    before = known.looks[-2] if len(known.looks) > 1 else None
    return bool(before and before["model"] and before["verdict"] == "none")


def _open(known: Known, found: Mapping, asked: Asked) -> Step | None:
    """What would settle what is open; None where nothing is, or enough was tried."""
    rivals = found["rivals"]
    if not rivals or known.tried(rivals) >= TRIES:
        return None
    why = f"these logs do not tell {' from '.join(rivals)}"
    if not asked.designed:
        return _more(known, asked, why, rivals)
    if len(known.runs) >= asked.budget:
        return _spent(asked, why)
    how = {"design": found["diagnosis"], "role": FIT, "rivals": list(rivals)}
    return Step(RUN, f"{why}; a motion made for that should", how)


def _settled(found: Mapping) -> Step:
    """Let the gate judge what is named, and say what stays as good."""
    why = f"named: {_said(found)}; does held-out motion bear it out?"
    if found["model"] is not None:
        why += " It was found again beside the adopted model with more motion."
    if found["rivals"]:
        told = " and ".join(found["rivals"])
        why += f" {told} stay as good after {TRIES} motions made to tell them apart."
    if found["twins"]:
        why += f" As good on every motion: {', '.join(found['twins'])}."
    return Step(ADOPT, why, {"diagnosis": found["diagnosis"]})


def _doubt(known: Known, asked: Asked, why: str) -> Step:
    """Look at one family after the other, and no further than all of them."""
    if len(known.since) >= len(STANDARD):
        why = f"{why}; every family of motions was tried"
        return Step(STOP, why, {"why": UNDECIDED})
    return _more(known, asked, why)


def _more(known: Known, asked: Asked, why: str, rivals: Sequence[str] = ()) -> Step:
    """Run the next standard motion, if there may be one more."""
    if len(known.runs) >= asked.budget:
        return _spent(asked, why)
    kind = STANDARD[known.standard % len(STANDARD)]
    return _run(kind, FIT, why, rivals)


def _spent(asked: Asked, why: str) -> Step:
    why = f"{why}; but all {asked.budget} experiments of the budget are run"
    return Step(STOP, why, {"why": SPENT})


def _run(kind: str, role: str, why: str, rivals: Sequence[str] = ()) -> Step:
    return Step(RUN, why, {"kind": kind, "role": role, "rivals": list(rivals)})


def _diagnose(
    fit: Sequence[str], held_out: Sequence[str], model: str | None, why: str
) -> Step:
    runs = {"fit": list(fit), "held_out": list(held_out), "model": model}
    return Step(DIAGNOSE, why, runs)


def _whole(known: Known, why: str) -> Step:
    """Diagnose all logs together, from the model as described."""
    return _diagnose(known.fit, known.held_out, None, why)


def _said(found: Mapping) -> str:
    """What a diagnosis says, in a few words."""
    if found["effects"]:
        return " and ".join(found["effects"])
    joints = ", ".join(map(str, found["unexplained"]))
    return f"something without a name{' on joint ' + joints if joints else ''}"


def _again(known: Known, found: Mapping) -> bool:
    """Whether an earlier look, with less motion, named the same beside this model."""
    before = (look for look in known.looks[:-1] if look["model"] == found["model"])
    return any(
        look["effects"] and _same(look["effects"], found["classes"]) for look in before
    )


def _same(adopted: Sequence[str], classes: Sequence[Sequence[str]]) -> bool:
    """Whether each name that is adopted is one of a class, and no class is new."""
    left = [set(own) for own in classes]
    for name in adopted:
        own = next((c for c in left if name in c), None)
        if own is None:
            return False
        left.remove(own)
    return not left
