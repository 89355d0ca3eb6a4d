"""The flows without their steps: what is taken, and in which order."""

from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np

from flows.report import ReportTable, store_index
from flows.steps import diagnose, fit, validate
from flows.steps import experiment as campaign
from flows.steps.model_choice import ModelChoice
from tests.verdict_documents import typed

NAME = "irb140 #2: load friction on joint 2, 9.6 → 7.1 %"
SCORES = fit.StoredCalibration(SimpleNamespace(), (), {"model": "aa"})


def faked(monkeypatch, tmp_path):
    """Replace the steps of both flows; returns the order in which they are taken.

    To be called when Prefect has its settings.
    """
    from flows.pipelines import flows as nightly
    from flows.pipelines import tasks

    page = tmp_path / "report.html"
    page.write_text("<html>")
    taken = []

    def take(module, name, answer):
        def step(*given):
            taken.append((name, given))
            if isinstance(answer, Exception):
                raise answer
            return answer

        monkeypatch.setattr(module, name, step)

    due = datetime(2026, 11, 22, 2, tzinfo=UTC)
    clock = SimpleNamespace(scheduled_start_time=due)
    monkeypatch.setattr(nightly, "flow_run", clock)
    runs = {"fit": ["aa", "bb"], "held_out": ["cc"]}
    take(store_index, "store_diagnosis_page", page)
    take(nightly, "run_campaign", SimpleNamespace(new=("aa",), failed={}))
    monkeypatch.setattr(campaign, "group_runs_by_role", lambda *_: runs)
    monkeypatch.setattr(tasks, "read_verdict", lambda *_: typed({}))
    monkeypatch.setattr(diagnose, "build_diagnose_request", lambda *asked: asked)
    for module, name, answer in (
        (nightly, "resolve_adopted_model", ModelChoice("11" * 10, "model: adoption 3")),
        (nightly, "judge_adoption", SimpleNamespace(doubts=("nothing new",), verdict=typed({}))),
    ):
        take(module, name, answer)
    take(diagnose, "diagnose_stored_runs", ("dd", "ee"))
    monkeypatch.setattr(tasks, "read_run_robot", lambda runs, store: "irb140")
    monkeypatch.setattr(tasks, "format_run_name", lambda *_: NAME)
    for name in ("read_identification_logs", "read_calibration_runs"):
        monkeypatch.setattr(fit, name, lambda request: ((), ()))
    table = ReportTable(("model", "J1"), [("ls", "1.0")])
    for name in ("identified_parts", "calibrated_parts"):
        monkeypatch.setattr(tasks, name, lambda made: ["All of it.", table])
    monkeypatch.setattr(
        tasks.experiments, "build_validation_parts", lambda *_: ["All of it.", table]
    )
    take(fit, "identify", (SimpleNamespace(), "ff"))
    take(fit, "calibrate", SCORES)
    take(validate, "validate", ("ab", validate.Validation(0.25, np.array([0.001]))))
    return taken
