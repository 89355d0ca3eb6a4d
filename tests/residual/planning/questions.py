"""Questions that short logs of a synthetic arm leave open."""

from functools import cache
from unittest.mock import patch

from residual.diagnosis.diagnose import diagnose
from residual.diagnosis.open_question import build_open_question
from residual.robot.robot import load_robot
from sim.engine.plant_records import create_random_stream
from sim.plant.typical_sizes import draw_effect
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant

FAMILY, SECONDS = "slow_cyclic", 8.0


@cache
def logs(effect, seed):
    robot = load_robot("irb140")
    hidden = draw_effect(robot, effect, create_random_stream(seed, "draw"))
    parts = (("fit", "fit"), ("proof", "held_out"))
    plan = tuple(LogPlan(name, part, FAMILY, SECONDS) for name, part in parts)
    return robot, make(Plant(robot, (hidden,), seed), plan, seed)


@cache
def seen(effect, seed):
    robot, (fit, proof) = logs(effect, seed)
    with patch(
        "residual.diagnosis.diagnose.build_open_question", wraps=build_open_question
    ) as inside:
        diagnose(robot, [fit], held_out=[proof])
    return inside.call_args.args


@cache
def robot_and_question(effect, seed):
    return logs(effect, seed)[0], build_open_question(*seen(effect, seed))
