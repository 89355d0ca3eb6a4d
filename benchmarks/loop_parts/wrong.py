"""Wrong corrections: another sign, another joint, twice as much; what comes of them."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.figures import Figures, figure
from benchmarks.loop_parts.tracked_arms import Case
from residual.diagnosis.validation.worth import worth
from residual.model.control import Use, feed_forward
from residual.model.model import Model
from residual.model.term import Term
from sim.records import Reference
from sim.twin import drive


def wrong_figures(cases: Sequence[tuple[Case, Sequence[Reference]]]) -> Figures:
    """Count wrong corrections that pass the gate, or track as well as right ones."""
    passed, as_good, tried, right = 0, 0, 0, 0
    for case, references in cases:
        nominal, model = case.found.models["nominal"], case.found.known.model
        if not case.found.effects:
            continue
        right += not worth(model, nominal, case.held_out).passed
        best = _missed(case, references[0], model)
        for how, wrong in _wrongs(model, nominal):
            tried += 1
            through = worth(wrong, nominal, case.held_out).passed
            missed = _missed(case, references[0], wrong)
            passed += through
            as_good += missed <= best
            told = "passed" if through else "refused"
            print(f"{case.name:18} {how:6} {told}, {missed / best:.2f} x", flush=True)
    found = sum(bool(case.found.effects) for case, _ in cases)
    return {
        "wrong_corrections_adopted": figure(passed, 0, tried),
        "wrong_corrections_as_good": figure(as_good, 0, tried),
        "right_corrections_refused": figure(right, None, found),
    }


def _wrongs(model: Model, before: Model) -> Iterator[tuple[str, Model]]:
    had = {(t.effect.name, t.joints) for t in before.terms}
    new = [t for t in model.terms if (t.effect.name, t.joints) not in had]
    yield "sign", _changed(model, {id(t): replace(t, theta=-t.theta) for t in new})
    yield "twice", _changed(model, {id(t): replace(t, theta=2 * t.theta) for t in new})
    local = [t for t in new if t.effect.scope == "local"]
    if local:
        dof = model.robot.dof
        moved = {id(t): replace(t, joints=((t.joints[0] + 1) % dof,)) for t in local}
        yield "joint", _changed(model, moved)


def _changed(model: Model, other: dict[int, Term]) -> Model:
    return replace(model, terms=tuple(other.get(id(t), t) for t in model.terms))


def _missed(case: Case, reference: Reference, model: Model) -> float:
    """Error of all joints together on one motion [rad]."""
    motion = reference.q, reference.qd, reference.qdd
    torque = feed_forward(model, reference.t, motion, Use())
    done = drive(case.robot, reference, case.plant, torque)
    return float(np.linalg.norm(done.rms))
