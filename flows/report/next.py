"""The next experiment as a page for who runs it, and its motion as a picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flows.report import diagnosis
from flows.report.document import Chart, Table, Tile
from flows.report.figures import look
from flows.report.page import Origin, environment
from flows.report.words.outlook import (
    case_words,
    from_one_another,
    in_words,
    same_words,
)
from flows.report.words.phrases import joint_words
from flows.steps.planning.ask import Asked
from flows.steps.planning.design import Design, apart_by_no_motion
from residual.diagnosis.result import Diagnosis
from residual.planning.promise import SURE, sure_words
from residual.quantity import MISSING, fraction, number, probability
from residual.robot.robot import Robot
from sim.engine.records import Reference, TrajectorySpec
from sim.trajectories import make_reference
from sim.trajectories.excitation import usage
from sim.trajectories.limits import plan_limits

_RATE = 50.0  # Hz, of what is drawn
_MOST_POINTS, _HEIGHT = 1200, 300


@dataclass(frozen=True, eq=False, slots=True)
class Sheet:
    """All that the page of an experiment is made of.

    Attributes:
        asked: The verdict and what it leaves open.
        made: The motion.
        reference: Its samples.
        program: File with them; None where none was written.
        command: What diagnoses the log of it together with the others.
    """

    asked: Asked
    made: Design
    reference: Reference
    program: str | None
    command: str


def page_with_motion(found: Diagnosis, origin: Origin | None = None) -> str:
    """Return the page of a diagnosis, with the motion that it proposes drawn."""
    motion = motion_chart(found)
    return diagnosis.render(found, found.verdict.robot, motion=motion, origin=origin)


def motion_chart(found: Diagnosis) -> Chart | None:
    """Return the picture of the motion that a diagnosis proposes; None for none."""
    plan, nominal = found.verdict.next_experiment, found.models.get("nominal")
    if not plan or plan["family"] is None or nominal is None:
        return None
    told = plan["parameters"]
    spec = TrajectorySpec.from_record(
        {"kind": plan["family"], "duration": plan["seconds"], **told}
    )
    return angles_chart(make_reference(nominal.robot, spec, _RATE))


def angles_chart(reference: Reference) -> Chart:
    """Return the angles of a motion over time, a line a joint."""
    q = np.degrees(reference.q)
    data = [
        look.line(f"J{joint}", look.JOINTS[(joint - 1) % len(look.JOINTS)])
        | look.over_time(reference.t, column, _MOST_POINTS)
        for joint, column in enumerate(q.T, 1)
    ]
    x, y = look.axis("time (s)"), look.axis("angle (deg)")
    layout = look.layout("Angles of the joints", x, y, hovermode="x")
    alt = (
        f"Angles of {q.shape[1]} joints over {reference.t[-1]:g} s, from "
        f"{q.min():.0f} to {q.max():.0f} degrees."
    )
    caption = "Angles of the motion; it begins and ends at rest."
    plot = {"data": data, "layout": layout}
    return Chart("", alt, caption, plot=plot, height=_HEIGHT)


def render_sheet(sheet: Sheet) -> str:
    """Return the page: what the motion settles, how to run it, and what to do then."""
    page = environment().get_template("next.html")
    return page.render(_context(sheet))


def _context(sheet: Sheet) -> dict:
    made, robot = sheet.made, sheet.asked.robot
    same, cases = apart_by_no_motion(made.search.question, made.search.twins)
    told = from_one_another(made.rivals)
    return {
        "robot": robot.name,
        "headline": f"{made.best.spec.duration:g} s of motion to tell {told}",
        "tiles": _tiles(made),
        "chart": angles_chart(sheet.reference),
        "program": sheet.program,
        "rate": number(1 / (sheet.reference.t[1] - sheet.reference.t[0])),
        "start": [f"{x:.2f}" for x in np.degrees(sheet.reference.q[0])],
        "limits": limit_rows(robot, sheet.reference),
        "compared": comparison(made).rows[1:],
        "apart": [*same_words(same), *case_words(cases)],
        "command": sheet.command,
    }


def _tiles(made: Design) -> list[Tile]:
    best = made.best
    whole = f"that all {number(best.spec.duration)} s of it settle the question"
    return [
        Tile("Settled after", _seconds(best.after), f"chance {probability(SURE)}"),
        Tile("Chance", probability(best.sure.chance), whole),
    ]


def limit_rows(robot: Robot, reference: Reference) -> Sequence[tuple[str, ...]]:
    """Return joint, angles [deg], and shares of the robot's limits in words."""
    used, limits = usage(robot, reference), plan_limits(robot)
    rows = []
    for j in range(robot.dof):
        low, high = np.degrees([reference.q[:, j].min(), reference.q[:, j].max()])
        ends = np.degrees([limits.lower[j], limits.upper[j]])
        shares = (used.speed[j], used.acceleration[j], used.torque[j])
        told = ["no limit" if np.isnan(x) else f"{100 * x:.0f} %" for x in shares]
        span = f"{low:.1f} to {high:.1f} ({ends[0]:.0f} to {ends[1]:.0f})"
        rows.append((str(j + 1), span, *told))
    return rows


def told(made: Design) -> list[str]:
    """Return what a motion settles and how surely, a sentence each."""
    best, spec = made.best, made.best.spec
    same, cases = apart_by_no_motion(made.search.question, made.search.twins)
    words = sure_words(spec.duration, best.after, best.sure.chance)
    return [
        f"next experiment: {spec.duration:g} s of {spec.kind} motion in {spec.periods} "
        f"periods, to tell {from_one_another(made.rivals)}",
        f"the question is {words}",
        *same_words(same),
        *case_words(cases),
        "range, speed, acceleration, torque, floor and self-collision checked between "
        "samples too",
    ]


def comparison(made: Design) -> Table:
    """Return what other motions of the same length and limits would do."""
    best = made.best
    rows = [("this one", _seconds(best.after), probability(best.sure.chance))]
    rows += [
        (c.name, _seconds(c.seconds), probability(c.chance)) for c in made.compared
    ]
    heads = ("motion", "settled after", "chance by all of it")
    return Table(heads, rows, "same length, same limits")


def _seconds(value: float | None) -> str:
    return MISSING if value is None else f"{value:.1f} s"


def nothing_open(asked: Asked, made: Design | None) -> list[str]:
    """Return why there is no experiment to propose.

    Args:
        made: The best motion, which promises nothing; None where nothing was asked.
    """
    question, left = asked.question, asked.found.verdict.unexplained.joints
    if made is None and left:
        return [
            f"{joint_words(left)}: more remains than noise, and nothing speaks for any "
            "candidate there, so no motion could choose among them. The page of the "
            "diagnosis shows what it depends on."
        ]
    if made is None:
        return [
            "nothing is open: no finding has an equivalent, and no joint keeps more "
            "than noise. With --want you can ask for an effect of a given size."
        ]
    same, cases = apart_by_no_motion(question, made.search.twins)
    every = [r.place for c in question.contests for r in c.rivals]
    names = ", ".join(dict.fromkeys(map(in_words, every)))
    return [
        *same_words(same),
        *case_words(cases),
        f"no motion within the limits tells {names} from one another: the best one "
        f"brings {fraction(made.best.seen.share)} of the evidence that is needed. "
        "Another load, or a value that is known for sure, may.",
    ]
