"""Make a record again, and say whether it is the same, bit for bit; if not, why."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from flows.steps import experiment
from flows.steps.rerun import records, runs
from flows.steps.rerun.cause import Cause, cause_of
from residual.errors import InputError
from warehouse.commit import commit_record
from warehouse.compare import Channel, compare, differing
from warehouse.files import read_parquet, to_arrays
from warehouse.ids import data_hash
from warehouse.layout import Found, find
from warehouse.lineage import RERUN_OF
from warehouse.provenance import about_changes, provenance
from warehouse.runs import read_manifest
from warehouse.schema import SAMPLES_FILE
from warehouse.verify import faults, read_row

KIND = "rerun"
_MOST = 50  # differences that are kept on record
_TRUTH = "hidden truth"


@dataclass(frozen=True, eq=False, slots=True)
class Rerun:
    """What a rerun gave.

    Attributes:
        id: Id of the record.
        kind: Its kind, such as "runs".
        apart: Where the values differ, the earliest first; empty where none does.
        same_code: Whether the code is the one that made the record.
        cause: Why values differ; None where they do not.
        changes: Which uncommitted change of the code the record was made with.
        made: Id of the new record; None where nothing new was stored.
        noted: Id of the validation that says what differs; None where there is none.
        imported: Whether it was measured: then its values were checked, not made.
    """

    id: str
    kind: str
    apart: tuple[Channel, ...]
    same_code: bool
    cause: Cause | None
    changes: str
    made: str | None = None
    noted: str | None = None
    imported: bool = False

    @property
    def reproduced(self) -> bool:
        """Whether all values are the same, bit for bit."""
        return self.cause is None

    @property
    def verdict(self) -> str:
        """What differs and why, in one line."""
        if self.cause is None:
            return "same, bit for bit"
        where = self.apart[0].words if self.apart else "the stored record is damaged"
        more = len(self.apart) - 1
        where += f" (and {more} more)" if more > 0 else ""
        return f"{where}; cause: {self.cause.kind} ({self.cause.why})"


def rerun(id: str, store: Path, verify: bool = False) -> Rerun:
    """Make a record again from what it says of itself.

    Args:
        id: Id of a run, model, diagnosis or validation, or its beginning.

    Raises:
        InputError: If there is no such record or it cannot be made again: a measured
            run, a report, or a run whose sealed half is not there.
    """
    found, now = find(store, id), asdict(provenance())
    if found.kind == "runs":
        return _rerun_run(found, store, now, verify)
    return _rerun_record(found, store, now, verify)


def _rerun_run(found: Found, store: Path, now: Mapping, verify: bool) -> Rerun:
    manifest = read_manifest(store, found.id)
    if manifest.get("spec") is None:
        return _check_imported(found, store, manifest, verify)
    made = runs.again(store, found.id, manifest)
    apart = _run_apart(found, store, manifest, made)
    facts = _facts(found, store, (manifest["provenance"], now), apart)
    if verify:
        return Rerun(*facts)
    id = None
    if not facts[3]:
        id = experiment.keep(made, store, {RERUN_OF: [found.id]})
    return Rerun(*facts, id, _note(store, facts, found.folder.parent.name[6:], id))


def _rerun_record(found: Found, store: Path, now: Mapping, verify: bool) -> Rerun:
    if found.kind == "reports":
        raise InputError(
            f"{found.id} is a report: a page about a diagnosis. Make that one again: "
            "modelgap lineage names it."
        )
    row = read_row(found)
    then = json.loads(row.get("provenance") or "{}")
    with records.again(store, found) as (own, made):
        facts = _facts(found, store, (then, now), records.apart(found, made))
        if verify:
            return Rerun(*facts)
        other = made.id != found.id and not facts[3]
        id = records.keep(own, store, found, made) if other else None
        return Rerun(*facts, id, _note(store, facts, row["robot"], id))


def _facts(found: Found, store: Path, when: tuple, apart: tuple[Channel, ...]) -> tuple:
    """Return the first six attributes of a rerun."""
    then, now = when
    key = "code_hash" if found.kind == "runs" else "program_hash"
    apart, wrong = differing(apart), faults(found)
    cause = None
    if apart or wrong:
        cause = cause_of(then, now, key, wrong, store)
    same = then.get(key) == now[key]
    return found.id, found.kind, apart, same, cause, about_changes(store, then)


def _run_apart(found: Found, store: Path, manifest: Mapping, made) -> tuple:
    # Past the check of the hash: what was changed is to be found, not only refused.
    stored = to_arrays(read_parquet(found.folder / SAMPLES_FILE))
    names = ("t", "q", "qd", "qdd", "tau", "q_ref")
    logged = {name: getattr(made.log, name) for name in names}
    logged = {k: v for k, v in logged.items() if v is not None}
    apart = compare(stored, {**logged, **made.twin})
    if data_hash(made.truth) == manifest["truth_hash"]:
        return apart
    # Which of its channels would tell what is hidden.
    return (*apart, Channel(_TRUTH, "", False, note="other values"))


def _check_imported(
    found: Found, store: Path, manifest: Mapping, verify: bool
) -> Rerun:
    if not verify:
        raise InputError(
            f"Run {found.id} was measured, not simulated: it cannot be made again. "
            f"modelgap rerun {found.id[:8]} --verify checks its values against their "
            "hash."
        )
    wrong = faults(found)
    cause = Cause("damaged", "; ".join(wrong)) if wrong else None
    known = about_changes(store, manifest["provenance"])
    return Rerun(found.id, found.kind, (), True, cause, known, imported=True)


def _note(store: Path, facts: tuple, robot: str, made: str | None) -> str | None:
    """Keep on record that a rerun did not reproduce; None if it did."""
    outcome = Rerun(*facts)
    if outcome.cause is None:
        return None
    record = {
        "robot": robot,
        "kind": KIND,
        "verdict": outcome.verdict,
        "cause": outcome.cause.kind,
        "why": outcome.cause.why,
        "differing": len(outcome.apart),
        "differences": [asdict(c) for c in outcome.apart[:_MOST]],
        "changes": outcome.changes,
    }
    parents = {RERUN_OF: [outcome.id], **({KIND: [made]} if made else {})}
    return commit_record(store, "validations", record, parents=parents)
