"""Ask a method what changed, and judge the answer beside the truth as a row.

Silence about a change is a miss. A name is right if it is the truth's name and joints,
or if the answer itself says that the logs cannot tell the two apart.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from time import process_time

import numpy as np

from benchmarks.changes_parts import arms, peer, real
from benchmarks.changes_parts.case import DRIFT, EDGE, LOAD, MEASURED, Case, Made, Truth
from benchmarks.changes_parts.plant import as_effect, times
from benchmarks.harness.cases import guarded
from benchmarks.hidden.drawn import smallest
from benchmarks.hidden.score import Name, matched, members
from benchmarks.hidden.score import Said as Member
from residual.diagnosis.diagnose import diagnose
from residual.diagnosis.result import Verdict
from residual.errors import ModelgapError
from sim.plant.catalogue import amount, main_parameter, stated

# Effects whose parameters no log tells by themselves, so that no size is judged.
_NO_SIZE = ("presliding", "warmup")


@dataclass(frozen=True, slots=True)
class Said:
    """One name that an answer says, at one place."""

    name: Name
    alike: tuple[Name, ...] = ()  # what the answer says could be there instead
    values: Mapping[str, tuple[float | None, float | None]] = field(
        default_factory=dict
    )  # value and standard deviation by parameter; None where not told


@dataclass(frozen=True, slots=True)
class Answer:
    """What a method says of two epochs."""

    said: tuple[Said, ...]  # its names, the most important first
    flagged: tuple[int, ...]  # joints with a change that it has no name for
    seconds: float  # processor time that it took [s]
    nats: float | None = None  # evidence of the first name; None without one
    # Friction of all joints against the first epoch's, with its standard deviation;
    # None where it says nothing of that
    factor: tuple[float, float] | None = None


def judged(truths: Sequence[Truth], answer: Answer) -> dict:
    """Judge an answer as part of a row; what has no name cannot be named rightly."""
    named = [Name(t.name, t.joints) for t in truths if not t.name.startswith("x_")]
    hits, classes, extra = matched(named, answer.said)
    of_each = [hit or near for hit, near in zip(hits, classes, strict=True)]
    first = answer.said[0] if answer.said else None
    # Of a sum over a pair the first joint alone feels it.
    there = {
        joint
        for t in truths
        for joint in (t.joints[:1] if t.name == "x_cogging_sum" else t.joints)
    }
    row = {
        "truth": [[t.name, list(t.joints)] for t in truths],
        "names": [_plain(s.name) for s in answer.said],
        "alike": [[_plain(n) for n in s.alike] for s in answer.said],
        "right_first": first is not None and all(first is not s for s in extra),
        "by_name": first is not None and first.name in named,
        "found": sum(s is not None for s in of_each),
        "extra": [s.name.effect for s in extra],
        "flagged": list(answer.flagged),
        "flagged_right": bool(there & set(answer.flagged)),
        "seconds": round(answer.seconds, 3),
        "nats": answer.nats,
        "told_factor": answer.factor,
    }
    return row | (_estimate(truths[0], of_each) if named else {})


def _plain(name: Name) -> list:
    return [name.effect, list(name.joints)]


def _estimate(truth: Truth, of_each: Sequence[Said | None]) -> dict:
    """Return the main parameter of the first truth beside what is said of it."""
    said = of_each[0]
    out: dict = {"key": None, "value": None, "std": None, "true": None, "z": None}
    if said is None or said.name != Name(truth.name, truth.joints):
        return out
    key = main_parameter(truth.name, truth.parameters)
    value, std = said.values.get(str(key), (None, None))
    if key is None or value is None:
        return out
    true = float(truth.parameters[key])
    out |= {"key": key, "value": float(value), "std": std, "true": true}
    if truth.name not in _NO_SIZE and std is not None and np.isfinite(std) and std > 0:
        out["z"] = (float(value) - true) / float(std)
    return out


# Torques that a drive reports in its own unit: what it reports too much of all torque
# it reports too much of these, and no log can tell.
_LEVELS = ("coulomb", "stribeck", "coulomb_asymmetry", "presliding", "warmup")
_RATES = ("viscous", "viscous_asymmetry", "quadratic_viscous")
_IN_TORQUE = {
    **dict.fromkeys(_LEVELS, ("level",)),
    **dict.fromkeys(_RATES, ("coefficient",)),
    **dict.fromkeys(("position_friction", "balancer"), ("cos", "sin")),
    "offset": ("torque",),
    "spring": ("stiffness",),
    "ripple": ("amplitude",),
    "rotor_inertia": ("inertia",),
    "coupled_friction": ("level", "coefficient"),
}


@lru_cache(maxsize=2)
def make(case: Case) -> Made:
    return _measured(case) if case.group in MEASURED else _simulated(case)


def _simulated(case: Case) -> Made:
    effects = [as_effect(one) for one in case.planted]
    first = arms.record(case, arms.FIRST, ())
    second = arms.record(case, arms.SECOND, effects)
    many = len(case.second)
    reported = arms.truly(case).reported
    truth = []
    for one in case.planted:
        values = dict(one.parameters)
        for key in _IN_TORQUE.get(one.name, ()):
            # Of a pair the first joint is the one that the plant draws by.
            values[key] *= float(reported[one.joints[0] - 1])
        truth.append(Truth(one.name, tuple(sorted(one.joints)), values, one.size))
    factor = arms.warmed(case) if case.group == DRIFT else None
    robot = arms.robot_of(case.arm)
    return Made(robot, first, second[:many], second[many:], tuple(truth), factor)


def _measured(case: Case) -> Made:
    robot, truth = real.robot_of(case.arm), _truths(case)
    if case.group == LOAD:
        truth = (Truth("payload", (robot.dof,), {"mass": real.LOAD_MASS}, 0.0),)
    first = real.read(case, case.first)
    return Made(robot, first, real.planted_logs(case), (), truth)


PRODUCT, PEER = "product", "peer"

# Of what the peer names: the parameter that its first coefficient is.
_FIRST = {
    "offset": "torque",
    "coulomb": "level",
    "viscous": "coefficient",
    "spring": "stiffness",
    "load_friction": "coefficient",
    "torque_gain": "gain",
    "payload": "mass",
    "delay": "delay",
}


def methods_of(case: Case) -> tuple[str, ...]:
    """Return who is asked: what the program says of an arm is nothing to the peer."""
    return (PRODUCT,) if case.group == EDGE else (PRODUCT, PEER)


def run(case: Case) -> dict:
    """Ask every method about one made plant, a row each.

    A crash is a row like any other, and says nothing.
    """
    rows = [
        guarded(nothing(case, method), partial(_row, case, method))
        for method in methods_of(case)
    ]
    return {"rows": rows}


def nothing(case: Case, method: str) -> dict:
    """Return the row of a method that says nothing, as of one that crashed."""
    return _about(case, method) | judged(_truths(case), Answer((), (), 0.0))


def _about(case: Case, method: str) -> dict:
    return {
        "method": method,
        "group": case.group,
        "seed": case.seed,
        "index": case.index,
        "arm": case.arm,
        "background": case.background,
        "target": case.target,
        "effect": case.planted[0].name if case.planted else "",
    }


def _row(case: Case, method: str) -> dict:
    if case.group == EDGE:
        sized = _at_the_edge(case)
        if sized is None:
            return {"unsized": True, **nothing(case, method)}
        case = sized
    made, about = make(case), _about(case, method)
    try:
        answer = _ASK[method](made)
    except ModelgapError as refusal:
        # A log that is too short is refused: that is no crash, and no answer either.
        refused = {"refused": f"{type(refusal).__name__}: {refusal}"}
        return about | refused | judged(made.truth, Answer((), (), 0.0))
    planted = [[t.size, dict(t.parameters)] for t in made.truth]
    more = {"planted": planted, "true_factor": made.factor}
    return about | judged(made.truth, answer) | more


def _diagnosed(made: Made) -> Verdict:
    return diagnose(
        made.robot, made.second, baseline=made.first, held_out=made.held_out
    ).verdict


def ask_product(made: Made) -> Answer:
    begun = process_time()
    verdict = _diagnosed(made)
    seconds, drift = process_time() - begun, verdict.drift
    return Answer(
        said=tuple(Said(s.name, s.alike, _values(s)) for s in members(verdict)),
        flagged=tuple(verdict.unexplained.joints),
        seconds=seconds,
        nats=verdict.effects[0].evidence.nats if verdict.effects else None,
        factor=None if drift is None else (float(drift.factor), float(drift.std)),
    )


def ask_peer(made: Made) -> Answer:
    """Ask the peer, which names one thing at most."""
    begun = process_time()
    found, _ = peer.changes(made.robot.model, made.first, made.second)
    seconds = process_time() - begun
    best = next((change for change in found if change.found), None)
    if best is None:
        return Answer((), (), seconds)
    joints = (best.joint,) if best.joint else ()
    if best.name == "payload":
        joints = (made.robot.dof,)
    values = {}
    if best.name in _FIRST:
        # A load's deviations are those of combinations of its parameters.
        std = None if best.name == "payload" else float(best.deviation[0])
        values[_FIRST[best.name]] = (float(best.estimate[0]), std)
    said = Said(Name(best.name, joints), (), values)
    return Answer((said,), (), seconds, float(best.evidence))


def _values(said: Member) -> dict[str, tuple[float | None, float | None]]:
    """Return value and deviation of each parameter at one place of a finding."""
    place = said.place or 0
    return {
        key: p.pairs[place if len(p.pairs) > 1 else 0]
        for key, p in said.finding.parameters.items()
    }


def _truths(case: Case) -> tuple[Truth, ...]:
    return tuple(
        Truth(p.name, tuple(sorted(p.joints)), dict(p.parameters), p.size)
        for p in case.planted
    )


def _at_the_edge(case: Case) -> Case | None:
    """Return a case as large as half would be seen of; None where no size is said.

    The program says the size, of that arm unchanged and with other noise.
    """
    unchanged = replace(case, planted=(), noise=(case.noise + 1) % 2**31)
    sizes = _diagnosed(make(unchanged)).minimum_detectable
    one = case.planted[0]
    least = smallest(sizes, one.name, one.joints)
    values = dict(one.parameters)
    usual = amount(one.name, values)
    if least is None or not usual:
        return None
    factor = stated(one.name, float(least.value)) / usual
    many = tuple(sorted(times(one.name, values, factor).items()))
    return replace(case, planted=(replace(one, parameters=many),))


def words(result: Mapping) -> str:
    return "; ".join(f"{row['method']} {_words(row)}" for row in result["rows"])


def _words(row: Mapping) -> str:
    if "error" in row:
        return f"crash: {row['error'][:80]}"
    if "refused" in row:
        return row["refused"][:80]
    names = "; ".join(f"{n} {j}" for n, j in row["names"]) or "nothing"
    hidden = " + ".join(f"{n} {j}" for n, j in row["truth"]) or "nothing"
    mark = "right" if row["right_first"] else "-"
    if not row["truth"]:
        mark = "named" if row["names"] else "silent"
    flags = f" flagged {row['flagged']}" if row["flagged"] else ""
    return f"{mark}: {hidden} -> {names}{flags} ({row['seconds']:.1f} s)"


def joints_of(arm: str) -> int:
    robot_of = real.robot_of if arm in real.ARMS else arms.robot_of
    return robot_of(arm).dof


_ASK: Mapping[str, Callable[[Made], Answer]] = {PRODUCT: ask_product, PEER: ask_peer}
