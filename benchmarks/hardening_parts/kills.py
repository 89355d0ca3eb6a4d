"""kill -9 at random moments of what writes into a store.

For kills within a rerun: runs of an earlier version, and what makes them again.
"""

import multiprocessing
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter, sleep
from unittest.mock import patch

from benchmarks.harness.figures import Figures, figure, partial
from benchmarks.store_parts import made as stores
from benchmarks.store_parts.kills import kill_figures as campaign_figures
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.rerun import rerun
from residual.recording import Recording
from warehouse import commit
from warehouse.commit import commit_run
from warehouse.provenance import provenance

_OTHER = "f" * 64  # hash of the code of that version
_RUNS, _ROWS = 6, 400


def old_runs(store: Path) -> None:
    """Store simulated runs as another version of the program did."""
    told = replace(provenance(), code_hash=_OTHER)
    trajectory = {"kind": "fourier", "duration": 4.0}
    with (
        patch.object(commit, "provenance", lambda: told),
        patch.object(experiment, "_simulate", _arm(changed=False)),
    ):
        for seed in range(_RUNS):
            asked = {"schema": 1, "robot": "irb140", "seed": seed}
            plant = {"seed": seed, "salt": f"s{seed}"}
            spec = asked | {"trajectory": trajectory, "plant": plant}
            experiment.keep(experiment.make(ExperimentSpec.model_validate(spec)), store)


def rerun_old(store: Path) -> None:
    """Make these runs again by this version; every second one comes out otherwise."""
    rows = stores.answers(store)["runs"].select(["run_id", "code_hash"]).to_pylist()
    with patch.object(experiment, "_simulate", _arm(changed=True)):
        for row in rows:
            if row["code_hash"] == _OTHER:
                rerun(row["run_id"], store)


def _arm(changed: bool) -> Callable:
    def seeds(spec: ExperimentSpec) -> list[int]:
        seed = spec.plant_spec().seed
        return [seed, int(changed and seed % 2)]

    return stores.stand_in(seeds, _ROWS)


FULL = 200

provenance()  # slow the first time, and the same in every process forked from here


def kill_figures(quick: bool) -> Figures:
    """Kill campaigns, and other operations in turn; look, and do the work again."""
    kills = 12 if quick else FULL
    rng = random.Random(16)
    bad: list[str] = []
    others = kills - kills // 2
    with stores.folder() as place:
        for number in range(others):
            name = list(_WORK)[number % len(_WORK)]
            store, calm = place / f"store-{number}", place / f"calm-{number}"
            for each in (store, calm):
                stores.filled(each)
                if name == "rerun":
                    old_runs(each)
            wrong = _killed(store, calm, _WORK[name], rng)
            bad += [f"{name}: {line}" for line in wrong]
    entry = figure(len(bad), 0, others, told=bad[:5], operations=list(_WORK))
    if kills < FULL:
        entry = partial(entry, f"{kills} kills instead of {FULL}")
    campaigns = campaign_figures(quick, kills // 2)
    # The bars of that benchmark are for its own number of kills.
    return {"kills_not_whole": entry} | campaigns


def _killed(store: Path, calm: Path, work: Callable, rng: random.Random) -> list[str]:
    """Return what is wrong after a kill, and after the same work once more."""
    start = perf_counter()
    work(calm)
    whole = perf_counter() - start
    before = stores.answers(store)["runs"].column("run_id").to_pylist()
    context = multiprocessing.get_context("fork")
    process = context.Process(target=work, args=(store,))
    process.start()
    sleep(rng.uniform(0, 1.2 * whole))
    process.kill()
    process.join()
    wrong = stores.damaged(store)
    if set(before) - set(stores.answers(store)["runs"].column("run_id").to_pylist()):
        wrong.append("a run is lost")
    work(store)
    wrong += stores.damaged(store)
    if _content(store) != _content(calm):
        wrong.append("done again it is not the same")
    return wrong


def _content(store: Path) -> dict[str, list[str]]:
    """Return every row of every view but for when and from which code it was made."""
    out = ("created", "dirty", "code_hash")
    return {
        view: sorted(
            repr({k: v for k, v in row.items() if k not in out})
            for row in rows.to_pylist()
        )
        for view, rows in stores.answers(store).items()
    }


def _commits(store: Path) -> None:
    for seed in range(10, 18):
        stores.run(store, seed)


def _imports(store: Path) -> None:
    for seed in range(20, 28):
        log, _, _ = stores.small(seed)
        made = Recording("", "irb140", log.t, log.q, log.tau)
        commit_run(store, made, {"robot_hash": f"{stores.DOF:064x}"})


def _records(store: Path) -> None:
    ids = stores.answers(store)["runs"].column("run_id").to_pylist()
    stores.records(store, sorted(ids)[:2])


_WORK = {
    "commit": _commits,
    "import": _imports,
    "record": _records,
    "rerun": rerun_old,
}
