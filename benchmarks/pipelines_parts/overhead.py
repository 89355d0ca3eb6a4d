"""The same campaign bare and as a flow: its wall times [s] as JSON on the last line."""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, sleep
from unittest.mock import patch

from flows.requests import Campaign
from flows.settings import prefect_home, quiet_prefect
from flows.steps import campaign as steps
from flows.steps.experiment import PlannedExperiment
from warehouse.ids import record_folder

_NAP = 1.0  # s that an experiment takes here


def main(folder: Path, count: int) -> None:
    """Time both, once each.

    The experiments sleep for a second instead of simulating, so that the difference is
    not in the noise of other programs; everything around them is as always.
    """
    campaign = folder / "c.toml"
    campaign.write_text(f"[grid]\nseed = {list(range(1, count + 1))}\n")
    os.environ.update(quiet_prefect(prefect_home(folder / "flow")))
    # Prefect takes its settings when it is imported.
    from flows.pipelines.nightly import campaign as flow

    bare, store = folder / "bare", str(folder / "flow")
    planned = steps.planned_of(Campaign(str(campaign), store=bare))
    with patch.object(steps, "run_one", nap):
        plain = _time(lambda: steps.run_all(planned, bare))
        coated = _time(lambda: flow(str(campaign), store=store))
    print(json.dumps({"bare": plain, "flow": coated}))


def nap(planned: PlannedExperiment, store: str) -> str:
    """Take a second, and leave only the folder of a run."""
    sleep(_NAP)
    record_folder(Path(store), "runs", planned.run_id, "irb140").mkdir(parents=True)
    return planned.run_id


def _time(job: Callable[[], object]) -> float:
    start = perf_counter()
    job()
    return perf_counter() - start


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
