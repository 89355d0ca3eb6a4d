"""Arms with a load or a wrong link, and whether MuJoCo and Pinocchio take a model."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from benchmarks.attribution_parts.arms import SEVEN, SIX, Arm, make
from flows.steps.export import TARGETS
from residual.diagnosis.diagnose import diagnose
from residual.errors import InputError
from residual.model.bodies import build_body_sums
from residual.model.model import Model
from residual.verdict.result import Diagnosis
from sim.engine.plant_records import PlantEffect, create_random_stream
from sim.plant.typical_sizes import draw_plant_effect
from tests.exports.back import BACK

HIDDEN = (("payload",), ("link_inertia",), ("payload", "link_inertia"))
OFF = (0.0, 0.01, 0.03, 0.1)  # what is given, off the truth: a relative deviation
SEED = 32_000
CLOSE = {"mjcf": 1e-8, "urdf": 1e-8}  # N m: MuJoCo's and Pinocchio's torque and ours


@dataclass(frozen=True, slots=True)
class Case:
    arm: Arm
    names: tuple[str, ...]

    @property
    def hidden(self) -> list[PlantEffect]:
        rng = create_random_stream(self.arm.seed, "bodies")
        return [draw_plant_effect(self.arm.robot, rng, name) for name in self.names]


def cases(count: int, first: int = SEED) -> Iterator[Case]:
    for i in range(count):
        off = OFF[i // 2 % len(OFF)]
        arm = Arm((SIX, SEVEN)[i % 2], off, first + i, first + i + 500, quick=True)
        yield Case(arm, HIDDEN[i % len(HIDDEN)])


@cache
def diagnosed(case: Case) -> Diagnosis:
    logged = make(case.arm, case.hidden)
    return diagnose(logged.robot, logged.fit, (), logged.held_out)


def refusals(model: Model) -> list[str]:
    bad = build_body_sums(model).list_impossible(model.coefficients())
    out = [f"{name} cannot exist" for name in bad]
    for target, most in CLOSE.items():
        try:
            got, want = BACK[target](TARGETS[target](model))
            gap = np.abs(got - want).max()
            if gap > most:
                out.append(f"{target}: {gap:.2g} N m apart")
        except (InputError, ValueError) as error:
            out.append(f"{target}: {error}")
    return out
