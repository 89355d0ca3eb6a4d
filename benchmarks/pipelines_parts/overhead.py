"""The same campaign bare and as a flow: its wall times [s] as JSON on the last line."""

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import perf_counter, sleep
from typing import Any
from unittest.mock import patch

_NAP = 1.0  # s that an experiment takes here


def main(folder: Path, count: int) -> None:
    """Time both, once each.

    The experiments sleep for a second instead of simulating, so that the difference is
    not in the noise of other programs; everything around them is as always.
    """
    from flows.settings import prefect_home, quiet_prefect

    campaign = folder / "c.toml"
    campaign.write_text(f"[grid]\nseed = {list(range(1, count + 1))}\n")
    os.environ.update(quiet_prefect(prefect_home(folder / "flow")))
    from flows.requests import Campaign
    from flows.scheduled.flows import campaign as flow
    from flows.steps import campaign as steps

    asked, store = Campaign(str(campaign), store=folder / "bare"), str(folder / "flow")
    with patch.object(steps, "workers_of", _sleepers):
        bare = _time(lambda: steps.run_campaign(asked))
        coated = _time(lambda: flow(str(campaign), store=store))
    print(json.dumps({"bare": bare, "flow": coated}))


def _time(job: Callable[[], object]) -> float:
    start = perf_counter()
    job()
    return perf_counter() - start


class Sleepers:
    """A pool whose experiments take a second and leave only their folder."""

    def __init__(self, pool: Any) -> None:
        self._pool = pool

    def run(self, _work: object, jobs: Sequence[partial]) -> Iterator:
        """Yield jobs as they are done (`flows.workers.pool.Pool.run`)."""
        from flows.workers.pool import Done

        from flows.steps.experiment import run_id_of
        from warehouse.ids import record_folder

        for done in self._pool.run(sleep, [_NAP] * len(jobs)):
            spec, store, _ = jobs[done.index].args
            id = run_id_of(spec)
            record_folder(Path(store), "runs", id, "irb140").mkdir(parents=True)
            yield Done(done.index, id, done.error)


@contextmanager
def _sleepers(_runner: object, _jobs: int) -> Iterator[Sleepers]:
    from flows.workers.processes import Processes

    with Processes(2) as pool:
        yield Sleepers(pool)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
