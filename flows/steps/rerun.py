"""Compare two records of a store, verify all of them, or make one again bit for bit."""

import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa

from flows.inputs import substitute_robot_files
from flows.requests import Calibrate, Diagnose, Identify, Monitor, Request, Validate
from flows.specs import ExperimentSpec
from flows.steps import experiment, fit
from flows.steps.diagnose import diagnose_stored_runs
from flows.steps.experiment import (
    SimulatedExperiment,
    add_twin_errors,
    build_public_record,
    build_sealed_record,
    load_spec_robot,
    parse_sealed_plant,
    simulate_experiment,
)
from flows.steps.monitor import monitor
from flows.steps.validate import validate
from residual.errors import InputError, RunError
from warehouse.code_provenance import (
    format_uncommitted_change,
    read_code_provenance,
    read_package_versions,
)
from warehouse.record_commit import commit_record
from warehouse.record_ids import ID_DIGITS, convert_to_json_types, hash_arrays
from warehouse.remote_store import (
    check_store_folder,
    fetch_record,
    find_store_bucket,
    record_exists,
)
from warehouse.robots import find_used_robot
from warehouse.store_catalogue import (
    RERUN_OF,
    StoredRecord,
    find_record,
    list_record_ancestry,
    list_record_folders,
    open_seal,
    read_channels,
    read_manifest,
    read_record,
)
from warehouse.store_files import hash_table, read_parquet, table_to_arrays
from warehouse.verification import (
    GONE,
    ChannelDifference,
    compare_channels,
    compare_values,
    find_differing_values,
    find_record_faults,
    list_extra_files,
    read_catalogue_row,
    read_nested_tables,
    select_differing_channels,
    verify_store,
)
from warehouse.view_schema import INDEX, LOGGED, SAMPLES_FILE, SEALED

_CODE = ("commit", "dirty", "code_hash", "program_hash", "lock_hash", "machine")
# Keys of a manifest on values and origin, which are compared separately.
_APART = ("provenance", "data_hash", "truth_hash", "timings", "spec", "robot_hash")


@dataclass(frozen=True, eq=False, slots=True)
class Diff:
    """Two records side by side."""

    kind: str
    ids: tuple[str, str]
    # Values that differ, (name, one, other), by heading: spec, code, environment and
    # more; an empty table says that nothing there differs.
    tables: Mapping[str, tuple[tuple[str, object, object], ...]]
    # Their data, equal or not; of models and others only what differs.
    channels: tuple[ChannelDifference, ...]

    @property
    def same(self) -> bool:
        """Whether all values are equal, bit for bit."""
        return all(channel.equal for channel in self.channels)


def diff_records(first: str, second: str, store: Path) -> Diff:
    """Compare two records of one kind."""
    pair = [find_record(store, id) for id in (first, second)]
    if pair[0].kind != pair[1].kind:
        kinds = " and ".join(f"{each.id} is in {each.kind}" for each in pair)
        raise InputError(f"{kinds}; expected two records of one kind.")
    both = _runs if pair[0].kind == "runs" else _records
    tables, channels = both(store, *pair)
    return Diff(pair[0].kind, (pair[0].id, pair[1].id), tables, channels)


def _runs(store: Path, *pair: StoredRecord) -> tuple[dict, tuple[ChannelDifference, ...]]:
    manifests = [read_manifest(store, each.id) for each in pair]
    provenances = [each["provenance"] for each in manifests]
    spec = [{**(each.get("spec") or {}), "sealed": each.get("sealed_sha256")} for each in manifests]
    others = [{k: v for k, v in each.items() if k not in _APART} for each in manifests]
    tables = {
        "spec": _pairs(*spec),
        **_provenance_tables(store, *provenances),
        "manifest": _pairs(*others),
    }
    return tables, compare_channels(*(read_channels(store, each.id) for each in pair))


def _records(store: Path, *pair: StoredRecord) -> tuple[dict, tuple[ChannelDifference, ...]]:
    rows = [read_catalogue_row(each) for each in pair]
    provenances = [json.loads(row["provenance"]) for row in rows]
    records = [json.loads(row["record"]) for row in rows]
    requests = [record.pop("request", None) or {} for record in records]
    tables = {
        "request": _pairs(*requests),
        **_provenance_tables(store, *provenances),
        "values": _pairs(*records),
    }
    channels = (c for c in compare_records(*pair) if not c.name.startswith("request"))
    return tables, tuple(channels)


def _provenance_tables(store: Path, first: Mapping, second: Mapping) -> dict:
    code = [{key: side.get(key) for key in _CODE} for side in (first, second)]
    changes = [(side.get("uncommitted") or {}).get("sha256") for side in (first, second)]
    for side, sha256 in zip(code, changes, strict=True):
        side["uncommitted"] = sha256
    packages = list_package_changes(first, second, store)
    return {
        "code": _pairs(*code),
        "environment": tuple((name, *pair) for name, pair in packages.items()),
    }


def _pairs(first: Mapping, second: Mapping) -> tuple[tuple[str, object, object], ...]:
    return tuple(
        (name, *(None if value is GONE else value for value in pair))
        for name, *pair in find_differing_values(first, second)
    )


def find_damaged_files(place: Path) -> Iterator[str]:
    """Read a store and yield a line for each damaged or missing file.

    Raises:
        InputError: If there is none.
        RunError: After the last line, if something is damaged or missing.
    """
    check_store_folder(place)
    counts: Counter = Counter()
    damaged = 0
    for each in verify_store(place):
        counts[each.kind] += 1
        damaged += bool(each.faults)
        for line in each.faults:
            yield f"DAMAGED  {each.kind} {each.id}: {line}"
    summary = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    yield f"verified {summary or 'an empty store'}"
    if find_store_bucket(place) is None and place.stat().st_mode & 0o077:
        yield f"note: other users of this machine can read the store: chmod 700 {place}"
    index = f", and {INDEX}" if find_store_bucket(place) else ""
    if damaged:
        raise RunError(
            f"{damaged} of {counts.total()} are damaged. Remove their folders from the "
            f"store{index}; the commands that made them can make most of them again."
        )


KIND = "rerun"
_MOST_PACKAGES = 6  # that are named; the others are counted
_MOST_DIFFERENCES = 50  # that are stored
_OTHER = (
    "its spec is of another version of this program. Check out the "
    "commit that 'modelgap show' names."
)


@dataclass(frozen=True, slots=True)
class DifferenceCause:
    """Why values differ: a kind, such as "code" or "environment", and the evidence."""

    kind: str
    why: str


@dataclass(frozen=True, eq=False, slots=True)
class Rerun:
    """The result of a rerun."""

    id: str  # id of the record
    kind: str  # its kind, such as "runs"
    # Where the values differ, the earliest first; empty where none does.
    differences: tuple[ChannelDifference, ...]
    same_code: bool  # whether the code is the one that made the record
    cause: DifferenceCause | None  # why values differ; None where they do not
    changes: str  # uncommitted changes of the code that made the record
    new_id: str | None = None  # id of the new record; None where nothing new was stored
    # Id of the validation with the differences; None where there is none.
    note_id: str | None = None
    # Whether it was measured: then its values were checked, not recomputed.
    imported: bool = False

    @property
    def reproduced(self) -> bool:
        """Whether all values are the same, bit for bit."""
        return self.cause is None

    @property
    def verdict(self) -> str:
        """The differences and their cause, in one line."""
        if self.cause is None:
            return "same, bit for bit"
        where = self.differences[0].words if self.differences else "the stored record is damaged"
        more = len(self.differences) - 1
        where += f" (and {more} more)" if more > 0 else ""
        return f"{where}; cause: {self.cause.kind} ({self.cause.why})"


def rerun(id: str, store: Path, verify: bool = False) -> Rerun:
    """Make a record again from its stored request.

    Args:
        verify: Only compare; otherwise a record by other code and a difference are stored.
    """
    record = find_record(store, id)
    if record.kind == "runs":
        return _rerun_run(record, store, verify)
    if record.kind == "reports":
        raise InputError(
            f"{record.id} is a report: a page about a diagnosis. Rerun the diagnosis: "
            "modelgap lineage names it."
        )
    row, id = read_catalogue_row(record), None
    with remake_record(store, record) as (temporary, new):
        then = json.loads(row["provenance"])
        outcome = _outcome(record, store, then, compare_records(record, new))
        if verify:
            return outcome
        if new.id != record.id and not outcome.same_code:
            id = commit_rerun(temporary, store, record, new)
    return _with_note(outcome, store, row["robot"], id)


def _rerun_run(record: StoredRecord, store: Path, verify: bool) -> Rerun:
    manifest, new = read_manifest(store, record.id), None
    then = manifest["provenance"]
    if manifest.get("spec") is None:
        if not verify:
            raise InputError(
                f"Run {record.id} was measured, not simulated: it cannot be made "
                f"again. modelgap rerun {record.id[:8]} --verify checks its values "
                "against their hash."
            )
        wrong = find_record_faults(record)
        cause = DifferenceCause("damaged", "; ".join(wrong)) if wrong else None
        known = format_uncommitted_change(then)
        return Rerun(record.id, record.kind, (), True, cause, known, imported=True)
    simulated = rerun_experiment(store, record.id, manifest)
    # Without the check of the hash: the change is to be located, not only refused.
    stored = table_to_arrays(read_parquet(record.folder / SAMPLES_FILE))
    logged = {name: getattr(simulated.log, name) for name in LOGGED}
    logged = {name: values for name, values in logged.items() if values is not None}
    differences = compare_channels(stored, {**logged, **simulated.twin})
    if hash_arrays(simulated.truth) != manifest["truth_hash"]:
        # Its channels, which would reveal the hidden effect.
        hidden = ChannelDifference("hidden truth", "", False, note="other values")
        differences = (*differences, hidden)
    outcome = _outcome(record, store, then, differences)
    if verify:
        return outcome
    if not outcome.same_code:
        new = experiment.store_experiment(simulated, store, {RERUN_OF: [record.id]})
    return _with_note(outcome, store, record.folder.parent.name[6:], new)


def _outcome(
    record: StoredRecord, store: Path, then: Mapping, differences: tuple[ChannelDifference, ...]
) -> Rerun:
    key = "code_hash" if record.kind == "runs" else "program_hash"
    now = asdict(read_code_provenance())
    differences = select_differing_channels(differences)
    wrong = find_record_faults(record)
    cause = None
    if differences or wrong:
        cause = find_cause(then, now, key, wrong, store)
    known, same = format_uncommitted_change(then), then.get(key) == now[key]
    return Rerun(record.id, record.kind, differences, same, cause, known)


def _with_note(outcome: Rerun, store: Path, robot: str, new: str | None) -> Rerun:
    """Store that a rerun did not reproduce a record; nothing if it did."""
    if outcome.cause is None:
        return replace(outcome, new_id=new)
    record = {
        "robot": robot,
        "kind": KIND,
        "verdict": outcome.verdict,
        "cause": outcome.cause.kind,
        "why": outcome.cause.why,
        "differing": len(outcome.differences),
        "differences": [asdict(c) for c in outcome.differences[:_MOST_DIFFERENCES]],
        "changes": outcome.changes,
    }
    parents = {RERUN_OF: [outcome.id], **({KIND: [new]} if new else {})}
    note_id = commit_record(store, "validations", record, parents=parents)
    return replace(outcome, new_id=new, note_id=note_id)


# Why values differ.


def find_cause(
    then: Mapping, now: Mapping, key: str, faults: tuple[str, ...], store: Path
) -> DifferenceCause:
    """Return the most probable cause of a difference.

    Args:
        key: Which hash of code counts: code_hash for runs, program_hash for others.
        faults: Deviations from the committed record
            (``warehouse.verification.find_record_faults``).
        store: The store, which may have the list of packages of that time.
    """
    if faults:
        spec = any("spec is not the one" in fault for fault in faults)
        return DifferenceCause("seed or spec" if spec else "damaged", "; ".join(faults))
    if then.get(key) != now[key]:
        code = "the plant's code" if key == "code_hash" else "the program's code"
        old, new = (
            f"{(side.get(key) or 'unknown')[:12]} (commit {(side.get('commit') or 'unknown')[:12]})"
            for side in (then, now)
        )
        return DifferenceCause("code", f"{code} was {old}, is {new}")
    if packages := list_package_changes(then, now, store):
        named = [f"{k} {a or 'none'} -> {b or 'none'}" for k, (a, b) in packages.items()]
        more = len(named) - _MOST_PACKAGES
        named[_MOST_PACKAGES:] = [f"{more} more"] if more > 0 else []
        return DifferenceCause("environment", ", ".join(named))
    if then.get("machine") not in (None, now["machine"]):
        return DifferenceCause("machine", f"made on {then['machine']}, now on {now['machine']}")
    same = "code, environment, machine, spec and seeds are the same"
    return DifferenceCause("nondeterminism", same)


def list_package_changes(
    then: Mapping, now: Mapping, store: Path
) -> dict[str, tuple[str | None, str | None]]:
    """Return the packages whose version differs: then and now, by name."""
    other = then.get("environment_hash") != now.get("environment_hash")
    # Numerical packages first: the others seldom change a number.
    before, after = (dict(side.get("versions") or {}) for side in (then, now))
    listed = [read_package_versions(store, side) for side in (then, now) if other]
    if listed and None not in listed:
        for versions, packages in zip((before, after), listed, strict=True):
            versions |= dict(sorted(packages.items()))
    packages = {
        name: (before.get(name), after.get(name))
        for name in {**before, **after}
        if before.get(name) != after.get(name)
    }
    if other and not packages:
        return {"other packages": ("not on record", "not on record")}
    return packages


# A run once more, from its manifest and its seal.


def rerun_experiment(store: Path, run_id: str, manifest: Mapping) -> SimulatedExperiment:
    """Run the experiment of a run once more; nothing is written."""
    hidden = open_seal(store, run_id).spec
    word = find_used_robot(store, manifest["robot"], manifest.get("robot_hash"))
    spec = rebuild_spec({**manifest, "robot": word}, hidden)
    halves = (
        convert_to_json_types(build_sealed_record(spec.plant_spec())),
        convert_to_json_types(build_public_record(spec, load_spec_robot(spec))),
    )
    if halves != (hidden, manifest["spec"]):
        raise InputError(f"Run {run_id} cannot be made again: {_OTHER}")
    run = simulate_experiment(spec, store)
    same = {k: manifest[k] for k in ("robot", "serial", "tags") if k in manifest}
    return replace(run, manifest={**run.manifest, **same})


def rebuild_spec(manifest: Mapping, hidden: Mapping) -> ExperimentSpec:
    """Return the spec of a run, all seeds given."""
    plant = asdict(parse_sealed_plant(hidden))
    effects = [dict(e.pop("parameters")) | e for e in plant.pop("effects")]
    try:
        half = manifest["spec"]
        keys = ("schema", "seed", "start", "trajectory", "rates")
        content = {key: half[key] for key in keys} | {
            "controller": half.get("controller", {}),
            "drive": half.get("drive"),
            "robot": manifest["robot"],
            "plant": plant | {"effect": effects},
        }
        return ExperimentSpec.model_validate(content)
    except (KeyError, TypeError, ValueError):
        pass
    # Outside, for the error has values of the sealed half in it.
    raise InputError(f"A run cannot be made again: {_OTHER}")


# A model, diagnosis or validation once more, from its request and its ancestors.
#
# It is made in a temporary store that contains only the ancestors of the first one: so
# it can depend on nothing else, and nothing is written into the store of the first one.


def _identify(request: Identify) -> None:
    words = [*request.logs, *request.held_out]
    files = [w for w in words if len(w) < ID_DIGITS or set(w) - set("0123456789abcdef")]
    if files:
        raise InputError(
            f"It was identified from the file {files[0]}, which is not in the store. "
            "Import the log (modelgap import) and identify from the run."
        )
    fit.identify(request, fit.read_identification_logs(request))


def _calibrate(request: Calibrate) -> None:
    logs, runs = fit.read_calibration_runs(request)
    if request.paper:
        runs = add_twin_errors(logs.robot, runs)
    fit.calibrate(request, logs, runs)


# The request and the function of each verb.
_STEPS: Mapping[str, tuple[type[Request], Callable]] = {
    "diagnose": (Diagnose, diagnose_stored_runs),
    "identify": (Identify, _identify),
    "calibrate": (Calibrate, _calibrate),
    "validate": (Validate, validate),
    "monitor": (Monitor, monitor),
}


@contextmanager
def remake_record(store: Path, record: StoredRecord) -> Iterator[tuple[Path, StoredRecord]]:
    """Make a record once more; yields a store for the time being, and the new record in it."""
    content = read_record(store, record.id)
    request = content.get("request") or {}
    if request.get("step") not in _STEPS:
        raise InputError(
            f"{record.id} ({record.kind}) has no record of its request, so it cannot "
            "be made again. Records of identify, calibrate, diagnose, validate and "
            "monitor by this version have one."
        )
    verb, step = _STEPS[request["step"]]
    before = [each for each in list_record_ancestry(store, record.id) if each.id != record.id]
    runs = [read_manifest(store, each.id) for each in before if each.kind == "runs"]
    # Where to load each robot from, so that it is the one that was used.
    robots = {
        each["robot"]: find_used_robot(store, each["robot"], each.get("robot_hash"))
        for each in (*runs, request)
        if each.get("robot")
    }
    with TemporaryDirectory(prefix="modelgap-rerun-") as folder:
        temporary = Path(folder).resolve()
        for each in before:
            _link(each.folder, temporary / each.folder.relative_to(store))
            seal = Path(SEALED) / f"run_id={each.id}"
            # Feed-forward of a validation is on the arm of the seal.
            hidden = "feed_forward" in (content.get("kind") or "")
            if hidden and record_exists(store / seal):
                _link(store / seal, temporary / seal)
        with substitute_robot_files(robots):
            step(verb.from_record(request, temporary))
        new = set(list_record_folders(temporary, record.kind)) - {each.id for each in before}
        if len(new) != 1:
            raise InputError(
                f"Making {record.id} again gave {len(new)} records of {record.kind}, "
                "expected 1. Its request does not fit this version of the program."
            )
        yield temporary, find_record(temporary, new.pop())


def _link(folder: Path, target: Path) -> None:
    target.mkdir(parents=True)
    fetch_record(folder)
    for path in folder.iterdir():
        # A symbolic link would not do: SQL follows it out of the store and refuses.
        try:
            os.link(path, target / path.name)
        except OSError:
            shutil.copyfile(path, target / path.name)


def commit_rerun(temporary: Path, store: Path, old: StoredRecord, new: StoredRecord) -> str:
    """Store a record that was made again, with what was made with it; return its id."""
    renamed: dict[str, str] = {}
    for each in list_record_ancestry(temporary, new.id):
        if record_exists(store / each.folder.relative_to(temporary)):
            continue
        row = read_catalogue_row(each)
        parents = [(p["parent"], p["role"]) for p in row["lineage"] or []]
        parents = [(renamed.get(id, id), role) for id, role in parents]
        if each.id == new.id:
            parents.append((old.id, RERUN_OF))
        text = row["record"]
        for before, after in renamed.items():
            text = text.replace(before, after)
        tables, files = _parts(each)
        renamed[each.id] = commit_record(
            store,
            each.kind,
            json.loads(text),
            {name: table for name, table in tables.items() if len(table)},
            parents,
            files,
        )
    return renamed[new.id]


def _parts(record: StoredRecord) -> tuple[dict[str, pa.Table], dict[str, bytes]]:
    tables, files = dict(read_nested_tables(record)), {}
    for path in list_extra_files(record).values():
        if path.suffix == ".parquet":
            tables[path.stem] = read_parquet(path)
        else:
            files[path.name] = path.read_bytes()
    return tables, files


def compare_records(record: StoredRecord, other: StoredRecord) -> tuple[ChannelDifference, ...]:
    """Return where two records of one kind differ, value by value."""
    first, second = (json.loads(read_catalogue_row(each)["record"]) for each in (record, other))
    out = compare_values(first, second)
    (old, old_files), (new, new_files) = _parts(record), _parts(other)
    for name in old | new:
        out += _compare_tables(name, old.get(name), new.get(name))
    out += [
        ChannelDifference(name, "", False, note="another file")
        for name in old_files | new_files
        if old_files.get(name) != new_files.get(name)
    ]
    return tuple(out)


def _compare_tables(name: str, first: pa.Table | None, second: pa.Table | None) -> list:
    if (
        first is None
        or second is None
        or first.schema != second.schema
        or len(first) != len(second)
    ):
        hashes = {None if side is None else hash_table(side) for side in (first, second)}
        note = "another number of rows or other columns"
        return [ChannelDifference(name, "", False, note=note)] if len(hashes) > 1 else []
    out = []
    for column, a, b in zip(first.column_names, first.columns, second.columns, strict=True):
        at = f"{name}.{column}"
        if pa.types.is_floating(a.type):
            sides = [{at: c.to_numpy(zero_copy_only=False)} for c in (a, b)]
            out += [channel for channel in compare_channels(*sides) if not channel.equal]
        elif not a.equals(b):
            out.append(ChannelDifference(at, "", False, len(first), note="other values"))
    return out
