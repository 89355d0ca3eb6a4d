"""Measured arms: orders of their logs as two epochs."""

from functools import lru_cache
from itertools import combinations, permutations

from benchmarks.changes_parts.arms import Part
from benchmarks.measured_parts.arms import DAYS, KR300, LWR4, UR10, UR10E, absent, read_logs
from residual.recording import Recording

ARMS = (UR10E, KR300, LWR4, UR10)
_RUNS = {KR300: ("run_A", "run_B", "run_C"), LWR4: ("run_1", "run_2", "run_3")}
_THIRD = 27.5 / 3  # s, of the log of the UR10
_LOADED = "feb19_load.csv"
LOAD_MASS = 2.805  # kg, as its owners weighed it

Epochs = tuple[str, tuple[Part, ...], tuple[Part, ...]]


def epochs(load: bool) -> list[Epochs]:
    """Return arm, first and second epoch of every order of days or runs.

    With a load: of the day with the weighed load against one day and two days without.
    Arms without logs on this machine are left out.
    """
    out: list[Epochs] = []
    if load:
        before, after = (_file("feb12"), _file("feb19")), (Part(_LOADED),)
        out = [(UR10E, before[1:], after), (UR10E, before, after)]
    else:
        for first in combinations(DAYS, 2):
            others = [day for day in DAYS if day not in first]
            parts = tuple(map(_file, first))
            out += [(UR10E, parts, (_file(day),)) for day in others]
        for arm, runs in _RUNS.items():
            logs = [_file(run) for run in runs]
            out += [(arm, (a,), (b,)) for a, b in permutations(logs, 2)]
        thirds = [Part("run.csv", 0, i * _THIRD, _THIRD) for i in range(3)]
        out += [(UR10, (a,), (b,)) for a, b in permutations(thirds, 2)]
    return [each for each in out if not absent(each[0])]


def _file(name: str) -> Part:
    return Part(f"{name}.csv")


@lru_cache(maxsize=64)
def read(arm: str, part: Part) -> Recording:
    window = ""
    if part.duration:
        window = f"@{part.start:.6f}:{part.start + part.duration:.6f}"
    return read_logs(arm, [f"{part.source}{window}"])[0]
