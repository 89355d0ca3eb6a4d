"""Questions that short logs of a synthetic arm leave open."""

from functools import cache

from benchmarks.synthetic.logs import LogPlan, make
from benchmarks.synthetic.quasi_static import Plant
from residual.method.diagnose import diagnose
from residual.planning.question import open_question, parse_wish, wished_question
from residual.robot.robot import load_robot
from sim.draw import draw
from sim.engine.records import stream

FAMILY, SECONDS = "slow_cyclic", 8.0


@cache
def logs(effect, seed):
    robot = load_robot("irb140")
    hidden = draw(robot, effect, stream(seed, "draw"))
    parts = (("fit", "fit"), ("proof", "held_out"))
    plan = tuple(LogPlan(name, part, FAMILY, SECONDS) for name, part in parts)
    return robot, make(Plant(robot, (hidden,), seed), plan, seed)


@cache
def seen(effect, seed):
    robot, (fit, proof) = logs(effect, seed)
    known = []
    diagnose(robot, [fit], held_out=[proof], inside=lambda *all: known.append(all))
    return known[0]


@cache
def asked(effect, seed, want=None):
    examined, fitted, named = seen(effect, seed)
    if want:
        question = wished_question(examined, fitted, parse_wish(want))
    else:
        question = open_question(examined, fitted, named)
    return logs(effect, seed)[0], question
