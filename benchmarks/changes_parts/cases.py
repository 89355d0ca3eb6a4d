"""The list of cases: a pure function of the seed, made before any method has run.

A case whose size no arm can have is drawn again here, and never afterwards. The list
of the seeds that decide is a file of the repository (`LIST`); of others it is made
when it is asked for, which takes some seconds a case, and kept in store/benchmarks.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.changes_parts import arms, plant, real
from benchmarks.changes_parts.case import (
    CHANGE,
    DRIFT,
    EDGE,
    GROUPS,
    LOAD,
    PAIRS,
    REAL_CHANGE,
    REAL_UNCHANGED,
    SIZES,
    UNCHANGED,
    UNNAMED,
    Case,
    Part,
    from_json,
)
from benchmarks.harness.cases import kept_file, run_kept, seed_range
from benchmarks.measured_parts.arms import absent
from flows.workers.processes import InlineExecutor
from sim.engine.records import stream

DECIDING = "121101:121104"
LIST = Path(__file__).parent / "listed.json"

# Cases of each seed; of those with a size, of each size.
_MANY = {UNCHANGED: 25, CHANGE: 8, PAIRS: 4, UNNAMED: 6, DRIFT: 6, EDGE: 6}
_REAL_MANY = {real.UR10E: 7, "others": 3}
_REAL_SIZES = (0.10, 0.05)
# Kinds of arms in turn; five, so that every effect meets every kind.
_KINDS = ("six", "seven", "six", "seven", arms.ENGINE)
_SEVEN = (arms.SEVEN, arms.OTHER_SEVEN)
# Undeclared, of the arms of a group.
_DIRT = (("workshop", 0.5), ("worn", 0.3), ("clean", 0.2))
_FAMILIES = ("fourier", "cyclic", "move_stop_move")
_LOGS, _LENGTH, _TOTAL = (2, 4), (10.0, 20.0), 60.0  # s
_WARM = (300.0, 1500.0)  # s of work before a session that begins warm
_SAME_EFFECT, _TRIES = 12, 120  # draws, before another effect takes its turn; in all
_ROUNDS = 3  # of effects by their own step
# What decides which cases there are and how they look.
OWN = ("case.py", "arms.py", "plant.py", "added.py", "real.py", "cases.py")
BELOW = ("sim", "residual/robot")


@dataclass(frozen=True, slots=True)
class Slot:
    """A place in the list, before anything is drawn for it."""

    group: str
    seed: int
    index: int
    target: float = 0.0  # size asked for; 0 where none is
    kind: str = ""  # kind of arm, "" where it is drawn

    @property
    def name(self) -> str:
        """Key of what is drawn for it."""
        return " ".join(str(value) for value in asdict(self).values())


def listed(
    group: str,
    seeds: Sequence[int],
    quick: bool = False,
    pool: Any = None,
    committed: bool = True,
) -> list[Case]:
    """Return the cases of a group: of the committed list where they are in it.

    Orders of measured logs have no seeds. A quick run takes the first one; what nobody
    has listed yet is drawn by the pool, or here.
    """
    if group in (REAL_UNCHANGED, LOAD):
        cases = _orders(group)
        return cases[:1] if quick else cases
    wanted = _quick(group, seeds[0]) if quick else slots(group, seeds)
    if group == REAL_CHANGE:
        wanted = [slot for slot in wanted if not absent(slot.kind)]
    known = _committed() if committed else {}
    if all(slot.name in known for slot in wanted):
        return [from_json(known[slot.name]) for slot in wanted]
    jobs = {slot.name: slot for slot in wanted}
    plan = [f"benchmarks/changes_parts/{name}" for name in OWN]
    path = kept_file("changes-listed", *plan, *BELOW, code="cases")
    found = run_kept(path, _words, pool or InlineExecutor(), drawn, jobs)
    broken = [
        f"{name}: {row['error']}" for name, row in found.items() if "error" in row
    ]
    if broken:
        raise SystemExit("These cases could not be drawn: " + "; ".join(broken))
    return [from_json(found[slot.name]) for slot in wanted]


def slots(group: str, seeds: Sequence[int]) -> list[Slot]:
    if group == REAL_CHANGE:
        return [
            Slot(group, seed, index, target, kind)
            for seed in seeds
            for target in _REAL_SIZES
            for arm, many in _REAL_MANY.items()
            for index in range(many)
            for kind in [arm if arm == real.UR10E else _other(seed + index)]
        ]
    targets = {CHANGE: SIZES, PAIRS: SIZES[:1], UNNAMED: SIZES[:1]}
    return [
        Slot(group, seed, index, target)
        for seed in seeds
        for target in targets.get(group, (0.0,))
        for index in range(_MANY[group])
    ]


def write_list(seeds: str, pool: Any) -> int:
    many = seed_range(seeds)
    groups = [g for g in GROUPS if g not in (REAL_UNCHANGED, LOAD)]
    if missing := [arm for arm in real.ARMS if absent(arm)]:
        raise SystemExit(f"No list without the measured logs of {', '.join(missing)}.")
    found: dict[str, dict] = {}
    for group in groups:
        cases = listed(group, many, pool=pool, committed=False)
        places = slots(group, many)
        found |= {p.name: asdict(c) for p, c in zip(places, cases, strict=True)}
    # A line a case, so that a difference can be read.
    lines = ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in found.items())
    LIST.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
    return len(found)


def drawn(slot: Slot) -> dict:
    """Draw the case of a place, again and again until an arm can have it."""
    for attempt in range(_TRIES):
        name = f"changes/{slot.group}/{slot.target:g}/{slot.kind}/{slot.index}"
        rng = stream(slot.seed, f"{name}/{attempt}")
        one = _measured if slot.group == REAL_CHANGE else _simulated
        case = one(slot, attempt, rng)
        if case is not None:
            return asdict(case)
    raise ValueError(f"no arm can have {slot.name} in {_TRIES} draws")


def _simulated(slot: Slot, attempt: int, rng: np.random.Generator) -> Case | None:
    """Draw an arm, its sessions and what changed, None where it cannot have that."""
    names = _names(slot, attempt)
    place = slot.seed * _MANY[slot.group] + slot.index + attempt
    kind = slot.kind or _KINDS[place % len(_KINDS)]
    if any(name in plant.ENGINE_ONLY for name in names):
        kind = arms.ENGINE
    choices = {"six": arms.SIX, "seven": _SEVEN}.get(kind, (kind,))
    first = _motions(rng)
    second = first if rng.integers(2) else _motions(rng)  # in half of all the same
    held_out = _motions(rng)[:1]
    warm = rng.uniform(*_WARM, 2)
    cold, again = (int(x) for x in rng.integers(2, size=2))
    # Of a drift exactly one session begins warm.
    warm *= np.array([cold, 1 - cold if slot.group == DRIFT else again])
    case = Case(
        group=slot.group,
        seed=slot.seed,
        index=slot.index,
        arm=str(rng.choice(choices)),
        background=_dirt(slot.group, rng),
        plant=int(rng.integers(2**31)),
        noise=int(rng.integers(2**31)),
        worked=(float(warm[0]), float(warm[1])),
        first=first,
        second=second,
        held_out=held_out,
        target=slot.target,
    )
    for name in names:
        taken = tuple(j for p in case.planted for j in p.joints)
        one = plant.drawn(case, name, rng, slot.target, taken)
        if one is None:
            return None
        case = replace(case, planted=(*case.planted, one))
    return case


def _measured(slot: Slot, attempt: int, rng: np.random.Generator) -> Case | None:
    place = slot.seed * _REAL_MANY.get(slot.kind, _REAL_MANY["others"]) + slot.index
    # Another size of the same seed begins elsewhere.
    place += 5 * _REAL_SIZES.index(slot.target) + _instead(slot, attempt)
    name = real.EFFECTS[place % len(real.EFFECTS)]
    epochs = real.drawn_epochs(slot.kind, rng)
    about = (slot.group, slot.seed, slot.index, slot.kind, "", 0, 0, (0.0, 0.0))
    case = Case(*about, *epochs, target=slot.target)
    one = real.drawn(case, name, rng, slot.target)
    return None if one is None else replace(case, planted=(one,))


def _names(slot: Slot, attempt: int) -> tuple[str, ...]:
    """Return which effects are whose turn: dealt out, so that all come alike often."""
    many = _MANY[slot.group]
    turn = slot.seed * many + slot.index + _instead(slot, attempt)
    if slot.target and slot.group == CHANGE:
        turn += 9 * SIZES.index(slot.target)
    known = plant.UNNAMED if slot.group == UNNAMED else plant.EFFECTS
    if slot.group in (CHANGE, UNNAMED):
        return (known[turn % len(known)],)
    if slot.group == EDGE:
        # Of those whose torque grows with a number that a verdict may say.
        sized = [name for name in known if name not in ("presliding", "warmup")]
        return (sized[turn % len(sized)],)
    if slot.group == PAIRS:
        # Two apart in the order, another distance each round.
        step = 1 + (turn // len(known)) % (len(known) - 1)
        return known[turn % len(known)], known[(turn + 4 + step) % len(known)]
    return ()


def _instead(slot: Slot, attempt: int) -> int:
    """Return how far to go on where no arm can have an effect so large.

    Not always to the next one, which would come up too often; but to that in the end,
    since steps may come round to where they began.
    """
    rounds = attempt // _SAME_EFFECT
    step = 1 + (3 * slot.seed + slot.index) % 16
    return step * min(rounds, _ROUNDS) + max(rounds - _ROUNDS, 0)


def _motions(rng: np.random.Generator) -> tuple[Part, ...]:
    many = int(rng.integers(_LOGS[0], _LOGS[1] + 1))
    longest = min(_LENGTH[1], _TOTAL / many)
    return tuple(
        Part(
            str(rng.choice(_FAMILIES)),
            int(rng.integers(2**31)),
            0.0,
            float(round(rng.uniform(_LENGTH[0], longest))),
        )
        for _ in range(many)
    )


def _dirt(group: str, rng: np.random.Generator) -> str:
    words, odds = zip(*_DIRT, strict=True)
    drawn_word = str(rng.choice(words, p=odds))
    # Nothing warms on a clean arm.
    return words[0] if group == DRIFT and drawn_word == "clean" else drawn_word


def _other(turn: int) -> str:
    return real.OTHERS[turn % len(real.OTHERS)]


def _orders(group: str) -> list[Case]:
    if group == LOAD:
        orders = [(real.UR10E, *epochs) for epochs in real.load_epochs()]
    else:
        orders = real.unchanged_epochs()
    return [
        Case(group, 0, index, arm, "", 0, 0, (0.0, 0.0), first, second)
        for index, (arm, first, second) in enumerate(orders)
        if not absent(arm)
    ]


def _quick(group: str, seed: int) -> list[Slot]:
    """Return one place, of an arm that needs no physics engine."""
    sized = group in (CHANGE, PAIRS, UNNAMED, REAL_CHANGE)
    kind = real.UR10E if group == REAL_CHANGE else "six"
    return [Slot(group, seed, 0, SIZES[0] if sized else 0.0, kind)]


@cache
def _committed() -> dict[str, dict]:
    return json.loads(LIST.read_text(encoding="utf-8")) if LIST.exists() else {}


def _words(row: dict) -> str:
    many = " + ".join(
        f"{p['name']} {list(p['joints'])} {p['size']:.3f}" for p in row["planted"]
    )
    return f"{row['arm']} {row['background']}: {many or 'nothing'}"
