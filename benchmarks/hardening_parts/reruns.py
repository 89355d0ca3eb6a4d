"""Runs of an earlier version, and what makes them again: for kills within a rerun."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np

from benchmarks.hardening_parts.made import answers
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.rerun.rerun import rerun
from residual.recording import Recording
from warehouse import commit
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
    """Make these runs again by this version; every second one comes out otherwise.

    What comes out is stored, and where it differs, so is a record that says so.
    """
    rows = answers(store)["runs"].select(["run_id", "code_hash"]).to_pylist()
    with patch.object(experiment, "_simulate", _arm(changed=True)):
        for row in rows:
            if row["code_hash"] == _OTHER:
                rerun(row["run_id"], store)


def _arm(changed: bool) -> Callable:
    """In place of the simulated arm: arrays that the spec decides."""

    def simulate(spec: ExperimentSpec, robot) -> tuple:
        seed = spec.plant_spec().seed
        rng = np.random.default_rng([seed, int(changed and seed % 2)])
        q, tau, e_q, e_tau = rng.normal(size=(4, _ROWS, robot.dof))
        made = SimpleNamespace(
            log=Recording("", robot.name, np.arange(_ROWS) / 100, q, tau),
            twin={"e_q": e_q, "e_tau": e_tau},
            truth={"q": q},
        )
        return made, {}

    return simulate
