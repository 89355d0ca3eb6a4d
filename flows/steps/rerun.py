"""Make a record again, and say whether it is the same, bit for bit; if not, why."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment, rerun_records
from flows.steps.experiment import (
    Simulated,
    checked_robot,
    make,
    open_half,
    plant_of,
    sealed_half,
)
from residual.errors import InputError
from warehouse.commit import commit_record
from warehouse.compare import Channel, compare, differing
from warehouse.files import read_parquet, to_arrays
from warehouse.ids import data_hash, plain
from warehouse.layout import RERUN_OF, Found, find
from warehouse.provenance import about_changes, provenance, read_packages
from warehouse.runs import open_seal, read_manifest, robot_word
from warehouse.schema import SAMPLES_FILE
from warehouse.verify import faults, read_row

_OTHER = (
    "its spec is of another version of this program than this one. Check out the "
    "commit that 'modelgap show' names."
)


def again(store: Path, run_id: str, manifest: Mapping) -> Simulated:
    """Run the experiment of a run once more; nothing is written."""
    hidden = open_seal(store, run_id).spec
    word = robot_word(store, manifest["robot"], manifest.get("robot_hash"))
    spec = spec_of({**manifest, "robot": word}, hidden)
    halves = plain(sealed_half(spec)), plain(open_half(spec, checked_robot(spec)))
    if halves != (hidden, manifest["spec"]):
        raise InputError(f"Run {run_id} cannot be made again: {_OTHER}")
    made = make(spec, store)
    return replace(made, manifest={**made.manifest, "robot": manifest["robot"]})


def spec_of(manifest: Mapping, hidden: Mapping) -> ExperimentSpec:
    """Return the spec of a run, all seeds given."""
    plant = asdict(plant_of(hidden))
    effects = [dict(e.pop("parameters")) | e for e in plant.pop("effects")]
    try:
        half = manifest["spec"]
        keys = ("schema", "seed", "start", "trajectory", "rates")
        content = {key: half[key] for key in keys} | {
            "controller": half.get("controller", {}),
            "robot": manifest["robot"],
            "plant": plant | {"effect": effects},
        }
        return ExperimentSpec.model_validate(content)
    except (KeyError, TypeError, ValueError):
        pass
    # Outside, for the error has values of the sealed half in it.
    raise InputError(f"A run cannot be made again: {_OTHER}")


CODE = "code"
ENVIRONMENT = "environment"
MACHINE = "machine"
SPEC = "seed or spec"
DAMAGED = "damaged"
CHANCE = "nondeterminism"
_MANY = 6  # packages that are named; the others are counted


@dataclass(frozen=True, slots=True)
class Cause:
    """Why values differ."""

    kind: str
    why: str


def cause_of(
    then: Mapping, now: Mapping, key: str, faults: tuple[str, ...], store: Path
) -> Cause:
    """Return the most probable cause of a difference.

    Args:
        key: Which hash of code counts: code_hash for runs, program_hash for others.
        faults: What is not as it was committed (``warehouse.verify.faults``).
        store: The store, which may have the list of packages of that time.
    """
    if faults:
        spec = any("spec is not the one" in fault for fault in faults)
        return Cause(SPEC if spec else DAMAGED, "; ".join(faults))
    if then.get(key) != now[key]:
        return Cause(CODE, _code(then, now, key))
    apart = environment_apart(then, now, store)
    if apart:
        return Cause(ENVIRONMENT, _listed(apart))
    if then.get("machine") not in (None, now["machine"]):
        return Cause(MACHINE, f"made on {then['machine']}, now on {now['machine']}")
    return Cause(CHANCE, "code, environment, machine, spec and seeds are the same")


def environment_apart(
    then: Mapping, now: Mapping, store: Path
) -> dict[str, tuple[str | None, str | None]]:
    """Return the packages whose version differs: then and now, by name."""
    if then.get("environment_hash") == now.get("environment_hash"):
        listed = ({}, {})
    else:
        listed = tuple(read_packages(store, side) for side in (then, now))
    if None in listed:
        listed = ({}, {})
    before, after = (
        {**(side.get("versions") or {}), **packages}
        for side, packages in zip((then, now), listed, strict=True)
    )
    # Those that compute first: the others seldom change a number.
    names = [*(then.get("versions") or {}), *sorted({*before, *after})]
    apart = {
        name: (before.get(name), after.get(name))
        for name in dict.fromkeys(names)
        if before.get(name) != after.get(name)
    }
    if not apart and then.get("environment_hash") != now.get("environment_hash"):
        return {"other packages": ("not on record", "not on record")}
    return apart


def _code(then: Mapping, now: Mapping, key: str) -> str:
    what = "the plant's code" if key == "code_hash" else "the program's code"
    commits = [(side.get("commit") or "unknown")[:12] for side in (then, now)]
    text = f"{what} was {_short(then.get(key))} (commit {commits[0]}"
    return f"{text}), is {_short(now[key])} (commit {commits[1]})"


def _short(hash: str | None) -> str:
    return hash[:12] if hash else "not on record"


def _listed(apart: Mapping) -> str:
    words = [
        f"{name} {old or 'none'} -> {new or 'none'}"
        for name, (old, new) in list(apart.items())[:_MANY]
    ]
    more = len(apart) - len(words)
    return ", ".join([*words, *([f"{more} more"] if more > 0 else [])])


KIND = "rerun"
_MOST = 50  # differences that are kept on record
_TRUTH = "hidden truth"


@dataclass(frozen=True, eq=False, slots=True)
class Rerun:
    """What a rerun gave."""

    id: str  # id of the record
    kind: str  # its kind, such as "runs"
    # Where the values differ, the earliest first; empty where none does.
    apart: tuple[Channel, ...]
    same_code: bool  # whether the code is the one that made the record
    cause: Cause | None  # why values differ; None where they do not
    changes: str  # which uncommitted change of the code the record was made with
    made: str | None = None  # id of the new record; None where nothing new was stored
    # Id of the validation that says what differs; None where there is none.
    noted: str | None = None
    # Whether it was measured: then its values were checked, not made.
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
    """Make a record again from what it says of itself."""
    found, now = find(store, id), asdict(provenance())
    if found.kind == "runs":
        return _rerun_run(found, store, now, verify)
    return _rerun_record(found, store, now, verify)


def _rerun_run(found: Found, store: Path, now: Mapping, verify: bool) -> Rerun:
    manifest = read_manifest(store, found.id)
    if manifest.get("spec") is None:
        return _check_imported(found, store, manifest, verify)
    made = again(store, found.id, manifest)
    apart = _run_apart(found, store, manifest, made)
    facts = _facts(found, store, manifest["provenance"], now, apart)
    if verify:
        return facts
    id = None
    if not facts.same_code:
        id = experiment.keep(made, store, {RERUN_OF: [found.id]})
    note = _note(store, facts, found.folder.parent.name[6:], id)
    return replace(facts, made=id, noted=note)


def _rerun_record(found: Found, store: Path, now: Mapping, verify: bool) -> Rerun:
    if found.kind == "reports":
        raise InputError(
            f"{found.id} is a report: a page about a diagnosis. Make that one again: "
            "modelgap lineage names it."
        )
    row = read_row(found)
    then = json.loads(row.get("provenance") or "{}")
    with rerun_records.again(store, found) as (own, made):
        facts = _facts(found, store, then, now, rerun_records.apart(found, made))
        if verify:
            return facts
        other = made.id != found.id and not facts.same_code
        id = rerun_records.keep(own, store, found, made) if other else None
        return replace(facts, made=id, noted=_note(store, facts, row["robot"], id))


def _facts(
    found: Found, store: Path, then: Mapping, now: Mapping, apart: tuple[Channel, ...]
) -> Rerun:
    """Return what a rerun shows, before anything of it is kept."""
    key = "code_hash" if found.kind == "runs" else "program_hash"
    apart, wrong = differing(apart), faults(found)
    cause = None
    if apart or wrong:
        cause = cause_of(then, now, key, wrong, store)
    same = then.get(key) == now[key]
    return Rerun(found.id, found.kind, apart, same, cause, about_changes(store, then))


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


def _note(store: Path, outcome: Rerun, robot: str, made: str | None) -> str | None:
    """Keep on record that a rerun did not reproduce; None if it did."""
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
