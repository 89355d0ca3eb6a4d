"""What a blind study hides, and in which motions: drawn, the same for the same seed.

Ten cases share one excitation. A study of more cases begins with those of a shorter
one, so that it can be made longer at any time.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Annotated

from cyclopts import Parameter

from flows.blind.score import NOTHING, PAIR, SINGLE, UNKNOWN
from flows.inputs.given import load
from flows.requests import GivenWord, Request
from flows.specs.experiment import derived_seed
from residual.effects import registry
from residual.errors import InputError, check_name
from residual.robot.robot import Robot
from sim.engine.records import BACKGROUNDS, WORKSHOP, BackgroundWord, stream
from sim.plant.catalogue import kinds, unnamed

SHARED = 10  # cases per excitation
# Of twenty cases; in an order of their own in every twenty.
_KINDS = (*10 * (SINGLE,), *3 * (PAIR,), *4 * (NOTHING,), *3 * (UNKNOWN,))
# In minimum detectable sizes. One of a pair must not be lost in the other.
MULTIPLES, OF_A_PAIR = (1.0, 3.0, 5.0, 10.0), (3.0, 5.0, 10.0)
_FAMILIES = ("fourier", "cyclic", "move_stop_move")
_EXPERIMENTS = (3, 4, 5, 6)
_HELD_OUT = ("welding", "fourier")  # one of a family that is never fitted
TORQUE_NOISE, ENCODER = (0.005, 0.015, 0.03), (5e-5, 1e-4, 2e-4)
_PAUSE = 10.0  # s


@dataclass(frozen=True, slots=True)
class StudyRequest(Request):
    """Which study.

    Attributes:
        n: Number of cases; 20 to 30 s of one core each.
        seed: Seed of everything; the same seed is the same study.
        duration: Length of every experiment [s].
        background: What all joints have beside what is hidden: nothing, that of an arm
            in use, or twice as much.
    """

    n: Annotated[int, Parameter(name="--n")] = 20
    seed: int = 0
    robot: GivenWord = "irb140"
    duration: float = 20.0
    background: BackgroundWord = WORKSHOP

    def __post_init__(self) -> None:
        if self.n < 1:
            raise InputError(f"--n is {self.n}, expected 1 or more.")
        if not 0 <= self.seed < 2**63:
            raise InputError(f"--seed {self.seed}: expected 0 to {2**63 - 1}.")
        check_name(self.background, BACKGROUNDS, "background")


@dataclass(frozen=True, slots=True)
class Excitation:
    """Motions and noise that some cases share."""

    index: int
    fit: tuple[str, ...]  # families of the experiments to diagnose, in order
    held_out: tuple[str, ...]  # families of those for the proof
    torque: float  # noise of the torque, as a share of each joint's range
    encoder: float  # step of the encoders [rad]


@dataclass(frozen=True, slots=True)
class Wish:
    """One effect to hide."""

    effect: str
    multiple: float | None  # its size in minimum detectable ones; None for a usual size


@dataclass(frozen=True, slots=True)
class Draft:
    """One case before the sizes are known."""

    index: int
    drawn: str  # kind of case (``blind_score.DRAWN``)
    wishes: tuple[Wish, ...]  # what to hide
    excitation: Excitation


def drafts(request: StudyRequest) -> list[Draft]:
    """Return the cases of a study."""
    known, unknown = vocabulary(load(request.robot))
    drawn_kinds = _forever(request.seed, "kinds", _KINDS)
    named = _forever(request.seed, "effects", known)
    strange = _forever(request.seed, "unknown", unknown)
    out = []
    for index in range(request.n):
        drawn, rng = next(drawn_kinds), stream(request.seed, f"multiples/{index}")
        wishes: tuple[Wish, ...] = ()
        if drawn == SINGLE:
            wishes = (Wish(next(named), float(rng.choice(MULTIPLES))),)
        if drawn == PAIR:
            one = next(named)
            other = next(name for name in named if name != one)
            wishes = tuple(
                Wish(name, float(rng.choice(OF_A_PAIR))) for name in (one, other)
            )
        if drawn == UNKNOWN:
            wishes = (Wish(next(strange), None),)
        out.append(Draft(index, drawn, wishes, excitation(request, index // SHARED)))
    return out


def excitation(request: StudyRequest, index: int) -> Excitation:
    """Return one excitation; every one has a Fourier motion, which shows the most."""
    rng = stream(request.seed, f"excitation/{index}")
    count = int(rng.choice(_EXPERIMENTS))
    more = (str(kind) for kind in rng.choice(_FAMILIES, count - 1))
    noise = float(rng.choice(TORQUE_NOISE)), float(rng.choice(ENCODER))
    return Excitation(index, ("fourier", *more), _HELD_OUT, *noise)


def motions(request: StudyRequest, excitation: Excitation) -> list[dict]:
    """Return the open half of each experiment, those to fit first."""
    out = []
    for place, kind in enumerate((*excitation.fit, *excitation.held_out)):
        name = f"excitation/{excitation.index}/{place}"
        out.append(
            {
                "robot": request.robot,
                "seed": request.seed,
                "start": place * (request.duration + _PAUSE),
                "trajectory": {
                    "kind": kind,
                    "duration": request.duration,
                    "seed": derived_seed(request.seed, name),
                },
            }
        )
    return out


def arm_of(request: StudyRequest, label: str, excitation: Excitation) -> dict:
    """Return the hidden half of an arm's experiments, without its effects.

    Args:
        label: Whose arm; each has scatter, noise and salt of its own.
    """
    noise = {"torque": excitation.torque, "encoder": excitation.encoder}
    return {
        "background": request.background,
        "noise": noise,
        "seed": derived_seed(request.seed, f"plant/{label}"),
        "salt": f"{derived_seed(request.seed, f'salt/{label}'):08x}",
    }


@cache
def vocabulary(robot: Robot) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what may be drawn: effects that have a name, and those that have none.

    The first are all that the diagnosis looks for and the plant can have, so that a
    new effect is in the next study without a word being said here.
    """
    named = [
        name
        for name, effect in sorted(registry().items())
        if name in kinds() and effect.candidates(robot.dof)
    ]
    # A broken sensor is the monitor's matter, and some of its faults have names here.
    return tuple(named), tuple(sorted(unnamed()))


def _forever(seed: int, name: str, items: tuple[str, ...]) -> Iterator[str]:
    """Yield the items round by round, every round in an order of its own."""
    turn = 0
    while True:
        rng = stream(seed, f"{name}/{turn}")
        yield from (items[i] for i in rng.permutation(len(items)))
        turn += 1
