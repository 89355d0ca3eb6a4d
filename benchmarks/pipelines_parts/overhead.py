"""What Prefect adds to a campaign: the same experiments bare and as a flow.

The experiments sleep for a second instead of simulating, so that other programs do not
hide the difference; everything around them is the code of the program.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep
from unittest.mock import patch

from benchmarks.harness.figures import FULL, Figures, figure, missing
from benchmarks.harness.origin import ROOT
from benchmarks.harness.rates import wall
from flows.settings import build_prefect_environment, prefect_home
from flows.steps import experiment as steps
from flows.steps.experiment import PlannedExperiment
from warehouse.record_ids import build_record_path

_BAR, _COUNT = 0.05, 100


def overhead_figures(quick: bool) -> Figures:
    """Return (flow - bare) / bare of the wall times of 100 experiments."""
    name = "prefect_overhead"
    if quick:
        return {name: missing(_BAR, FULL)}
    with TemporaryDirectory() as folder:
        words = [sys.executable, "-m", __name__, folder]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        return {name: missing(_BAR, done.stderr.strip()[-200:]) | {"ok": False}}
    times = json.loads(done.stdout.splitlines()[-1])
    value = (times["flow"] - times["bare"]) / times["bare"]
    return {name: figure(value, _BAR, _COUNT, seconds=times)}


def main(folder: Path) -> None:
    """Print both wall times [s] as JSON, in a process that has not loaded Prefect."""
    campaign, first = folder / "c.toml", folder / "first.toml"
    campaign.write_text(f"[grid]\nseed = {list(range(1, _COUNT + 1))}\n")
    first.write_text("[grid]\nseed = [0]\n")
    os.environ.update(build_prefect_environment(prefect_home(folder / "flow")))
    # Prefect reads its settings when it is imported.
    from flows.pipelines.flows import campaign as flow

    bare, store = folder / "bare", str(folder / "flow")
    planned = steps.plan_campaign(str(campaign), bare, None)
    with patch.object(steps, "run_planned_experiment", nap):
        flow(str(first), store=store)  # starts Prefect's server
        times = {
            "bare": wall(lambda: steps.run_campaign_experiments(planned, bare)),
            "flow": wall(lambda: flow(str(campaign), store=store)),
        }
    print(json.dumps(times))


def nap(planned: PlannedExperiment, store: str) -> str:
    """Sleep for a second and leave only the folder of a run."""
    sleep(1.0)
    build_record_path(Path(store), "runs", planned.run_id, "irb140").mkdir(parents=True)
    return planned.run_id


if __name__ == "__main__":
    main(Path(sys.argv[1]))
