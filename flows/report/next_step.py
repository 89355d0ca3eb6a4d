"""What to do after a verdict, in one line with its command; and how often a name came.

Words in capitals in a command are for the reader to fill in.
"""

from collections.abc import Sequence
from pathlib import Path

from flows.report.phrases import is_link_or_load
from flows.report.sentences import MORE_MOTION, list_wrong_values
from residual.verdict.result import Finding, Verdict
from warehouse.query.store import open_store

_LOGS = "LOG... --robot ROBOT"


def describe_next_step(verdict: Verdict) -> tuple[str, str]:
    """Return what to do next, in words, and the command that does it."""
    faults = verdict.log_check.faults if verdict.log_check else ()
    again = f"modelgap diagnose {_LOGS}"
    alike = {is_link_or_load(f) for f in verdict.effects if f.equivalent}
    if not verdict.trusted or any(fault.repair for fault in faults):
        return "apply the fix that the check proposes", f"modelgap check {_LOGS}"
    if any(fault.kind in MORE_MOTION for fault in faults):
        program = "modelgap trajectory fourier --robot ROBOT --out MOTION.csv"
        return "log a motion that shows more", program
    if alike == {True}:
        return "weigh the load and say so", f"{again} --known payload.mass=KG"
    if verdict.next_experiment or alike or verdict.suspected:
        motion = f"modelgap next VERDICT.json {_LOGS}"
        return "look for the motion that settles what is open", motion
    if verdict.verdict == "unknown":
        return "compare with healthy logs", f"{again} --baseline HEALTHY_LOG..."
    if verdict.error.same_run:
        return "prove it on a log that was not fitted", f"{again} --holdout OTHER_LOG"
    if verdict.effects:
        return "save the augmented model", f"{again} --save-model MODEL.json"
    if list_wrong_values(verdict):
        return "write the identified robot", f"modelgap identify {_LOGS} --out DIR"
    later = f"modelgap diagnose NEW_{_LOGS} --baseline LOG..."
    return "compare later logs with these", later


_RECORD = """
    WITH this AS (
        SELECT robot, any_value(serial) AS serial FROM verdicts
        WHERE diagnosis_id = $id GROUP BY robot
    )
    SELECT diagnosis_id,
           list_sort(list(DISTINCT run_id) FILTER (role = 'fit')) AS runs,
           list(DISTINCT {'name': effect, 'joints': joints})
               FILTER (effect IS NOT NULL) AS named
    FROM verdicts JOIN this USING (robot)
    WHERE verdicts.serial IS NOT DISTINCT FROM this.serial
    GROUP BY diagnosis_id ORDER BY min(verdicts.created), diagnosis_id
"""
_LAST = 20  # diagnoses of other runs that a record goes back


def describe_name_records(store: Path, id: str, effects: Sequence[Finding]) -> tuple[str, ...]:
    """Return for each finding of a diagnosis how often its arm's diagnoses had it.

    Counts diagnoses up to this one, of the same runs only the last.
    """
    with open_store(store) as opened:
        rows = opened.sql(_RECORD, {"id": id}).to_pylist()
    named_by_runs: dict[tuple, list] = {}
    for row in rows:
        runs = tuple(row["runs"] or (row["diagnosis_id"],))
        named_by_runs.pop(runs, None)
        named_by_runs[runs] = row["named"] or []
        if row["diagnosis_id"] == id:
            break
    last = list(named_by_runs.values())[-_LAST:]
    return tuple(_record(effect, last) for effect in effects)


def _record(effect: Finding, diagnoses: Sequence[Sequence[dict]]) -> str:
    if len(diagnoses) < 2:
        return "This is the first stored diagnosis of this arm: nothing repeats it yet."
    times = sum(
        any(
            named["name"] == effect.name
            and (not effect.joints or {*named["joints"]} & {*effect.joints})
            for named in each
        )
        for each in diagnoses
    )
    of = f"{len(diagnoses)} stored diagnoses of this arm, each of other runs"
    return f"Record: named in {times} of the last {of}."
