"""The next experiment as a page for who runs it."""

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from flows.report.document import Chart, Document, Section, Steps, Table, Tile
from flows.report.figures import look
from flows.report.page import render
from flows.report.words.outlook import (
    case_words,
    from_one_another,
    in_words,
    same_words,
)
from flows.report.words.phrases import joint_words, many, sentence_case, texts
from flows.steps.planning.ask import Asked
from flows.steps.planning.design import Design, apart_by_no_motion
from residual.planning.promise import SURE, sure_words
from residual.quantity import MISSING, fraction, number, probability
from residual.robot.robot import Robot
from sim.engine.records import Reference
from sim.trajectories.excitation import usage
from sim.trajectories.limits import plan_limits

_TEXT = texts()["next"]

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
    design, robot = sheet.made, sheet.asked.robot
    apart = [*map(sentence_case, _inseparable(design))]
    rivals = from_one_another(design.rivals)
    whole = f"that all {number(design.best.spec.duration)} s of it settle the question"
    return render(
        Document(
            title=f"modelgap: next experiment of {robot.name}",
            about=Markup("modelgap next experiment of <b>{}</b>").format(robot.name),
            headline=f"{design.best.spec.duration:g} s of motion to tell {rivals}",
            tiles=[
                Tile(
                    "Settled after",
                    _seconds(design.best.after),
                    f"chance {probability(SURE)}",
                ),
                Tile("Chance", probability(design.best.sure.chance), whole),
            ],
            sections=(
                Section(
                    "motion",
                    "The motion",
                    [angles_chart(sheet.reference), limits(robot, sheet.reference)],
                ),
                Section("run", "How to run it", [_how_to_run(sheet)]),
                Section(
                    "compared", "What other motions would do", [comparison(design)]
                ),
                Section("apart", "What no motion tells", [apart]),
            ),
        )
    )


def _how_to_run(sheet: Sheet) -> Steps:
    t, start = sheet.reference.t, np.degrees(sheet.reference.q[0])
    posture = ", ".join(f"J{j} {q:.2f}°" for j, q in enumerate(start, 1))
    load = "Write the program with <kbd>--out</kbd> and load it"
    if sheet.program:
        load = Markup("Load <kbd>{}</kbd>").format(sheet.program)
    return Steps(
        [
            _TEXT["clear"],
            f"Move the arm slowly to its first posture: {posture}.",
            _TEXT["program"].format(Markup(load), number(1 / (t[1] - t[0]))),
            "Run it once at a tenth of the speed, with a hand on the stop. Then run it "
            "at full speed: slower, it tells less.",
            "Log time, angles and torques as in the logs before: same load, same rate, "
            "same channels.",
            Markup(
                "Diagnose the new log together with the others: <kbd>{}</kbd>"
            ).format(sheet.command),
        ]
    )


def _inseparable(design: Design) -> list[str]:
    same, cases = apart_by_no_motion(design.question, design.twins)
    return [*same_words(same), *case_words(cases)]


def limits(robot: Robot, reference: Reference) -> Table:
    """Return joint, angles [deg], and shares of the robot's limits in words."""
    used, known = usage(robot, reference), plan_limits(robot)
    rows = []
    for j in range(robot.dof):
        low, high = np.degrees([reference.q[:, j].min(), reference.q[:, j].max()])
        ends = np.degrees([known.lower[j], known.upper[j]])
        shares = (used.speed[j], used.acceleration[j], used.torque[j])
        shown = ["no limit" if np.isnan(x) else f"{100 * x:.0f} %" for x in shares]
        span = f"{low:.1f} to {high:.1f} ({ends[0]:.0f} to {ends[1]:.0f})"
        rows.append((str(j + 1), span, *shown))
    heads = ("Joint", "Angles [deg]", "Speed", "Acceleration", "Torque")
    about = "What it uses of the limits; in brackets the range that is kept to"
    return Table(heads, rows, about, left=(0, 1))


def told(design: Design) -> list[str]:
    """Return what a motion settles and how surely, a sentence each."""
    best, spec = design.best, design.best.spec
    words = sure_words(spec.duration, best.after, best.sure.chance)
    return [
        f"next experiment: {spec.duration:g} s of {spec.kind} motion in "
        f"{many(spec.periods, 'period')}, to tell {from_one_another(design.rivals)}",
        f"the question is {words}",
        *_inseparable(design),
        "range, speed, acceleration, torque, floor and self-collision checked between "
        "samples too",
    ]


def comparison(design: Design) -> Table:
    """Return what other motions of the same length and limits would do."""
    rows = [
        (
            m.spec.kind.replace("_", " "),
            many(m.spec.periods, "period"),
            _seconds(m.after),
            probability(m.sure.chance),
        )
        for m in design.ranked
    ]
    heads = ("motion", "", "settled after", "chance by all of it")
    return Table(heads, rows, "the first is the one; same length, same limits")


def _seconds(value: float | None) -> str:
    return MISSING if value is None else f"{value:.1f} s"


def nothing_open(asked: Asked, design: Design | None) -> list[str]:
    """Return why there is no experiment to propose.

    Args:
        design: The best motion, which promises nothing; None where nothing was asked.
    """
    question, left = asked.question, asked.found.verdict.unexplained.joints
    if design is None and left:
        return [
            f"{joint_words(left)}: more remains than noise, and nothing speaks for any "
            "candidate there, so no motion could choose among them. The page of the "
            "diagnosis shows what it depends on."
        ]
    if design is None:
        return [
            "nothing is open: no finding has an equivalent, and no joint keeps more "
            "than noise."
        ]
    every = [r.place for c in question.contests for r in c.rivals]
    names = ", ".join(dict.fromkeys(map(in_words, every)))
    return [
        *_inseparable(design),
        f"no motion within the limits tells {names} from one another: the best one "
        f"brings {fraction(design.best.seen.share)} of the evidence that is needed. "
        "Another load, or a value that is known for sure, may.",
    ]
