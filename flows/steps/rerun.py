"""Make a record again, and say whether it is the same, bit for bit; if not, why."""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa

from flows.inputs.given import instead
from flows.requests import (
    Calibrate,
    Diagnose,
    Identify,
    Monitor,
    Request,
    Validate,
)
from flows.specs.experiment import ExperimentSpec
from flows.steps import calibrate, experiment, identify
from flows.steps.diagnose import diagnose_runs
from flows.steps.experiment import (
    Simulated,
    checked_robot,
    make,
    open_half,
    plant_of,
    sealed_half,
    with_twins,
)
from flows.steps.monitor import monitor
from flows.steps.validate import TRACKING, validate
from residual.errors import InputError
from warehouse.commit import commit_record
from warehouse.compare import (
    Channel,
    compare_channels,
    compare_values,
    differing_channels,
)
from warehouse.files import read_parquet, table_hash, to_arrays
from warehouse.ids import ID_DIGITS, data_hash, to_plain
from warehouse.layout import (
    RERUN_OF,
    StoredRecord,
    find,
    list_folders,
    read_record,
    with_parents,
)
from warehouse.provenance import describe_uncommitted, provenance, read_packages
from warehouse.remote import fetch_record, has_record
from warehouse.runs import open_seal, read_manifest, robot_word
from warehouse.schema import SAMPLES_FILE, SEALED
from warehouse.verify import faults, list_tables, other_files, read_row

_OTHER = (
    "its spec is of another version of this program than this one. Check out the "
    "commit that 'modelgap show' names."
)


def again(store: Path, run_id: str, manifest: Mapping) -> Simulated:
    """Run the experiment of a run once more; nothing is written."""
    hidden = open_seal(store, run_id).spec
    word = robot_word(store, manifest["robot"], manifest.get("robot_hash"))
    spec = spec_of({**manifest, "robot": word}, hidden)
    halves = to_plain(sealed_half(spec)), to_plain(open_half(spec, checked_robot(spec)))
    if halves != (hidden, manifest["spec"]):
        raise InputError(f"Run {run_id} cannot be made again: {_OTHER}")
    run = make(spec, store)
    return replace(run, manifest={**run.manifest, "robot": manifest["robot"]})


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
    record, now = find(store, id), asdict(provenance())
    if record.kind == "runs":
        return _rerun_run(record, store, now, verify)
    return _rerun_record(record, store, now, verify)


def _rerun_run(record: StoredRecord, store: Path, now: Mapping, verify: bool) -> Rerun:
    manifest = read_manifest(store, record.id)
    if manifest.get("spec") is None:
        return _check_imported(record, store, manifest, verify)
    simulated = again(store, record.id, manifest)
    apart = _run_apart(record, store, manifest, simulated)
    facts = _facts(record, store, manifest["provenance"], now, apart)
    if verify:
        return facts
    id = None
    if not facts.same_code:
        id = experiment.keep(simulated, store, {RERUN_OF: [record.id]})
    note = _note(store, facts, record.folder.parent.name[6:], id)
    return replace(facts, made=id, noted=note)


def _rerun_record(
    record: StoredRecord, store: Path, now: Mapping, verify: bool
) -> Rerun:
    if record.kind == "reports":
        raise InputError(
            f"{record.id} is a report: a page about a diagnosis. Make that one again: "
            "modelgap lineage names it."
        )
    if read_record(store, record.id).get("kind") == TRACKING:
        raise InputError(
            f"{record.id} is a record of tracking, which is shown and not rerun: "
            f"modelgap show {record.id[:8]}; or drive anew, by modelgap validate."
        )
    row = read_row(record)
    then = json.loads(row["provenance"])
    with made_again(store, record) as (own, new):
        facts = _facts(record, store, then, now, apart(record, new))
        if verify:
            return facts
        other = new.id != record.id and not facts.same_code
        id = keep_record(own, store, record, new) if other else None
        return replace(facts, made=id, noted=_note(store, facts, row["robot"], id))


def _facts(
    record: StoredRecord,
    store: Path,
    then: Mapping,
    now: Mapping,
    apart: tuple[Channel, ...],
) -> Rerun:
    """Return what a rerun shows, before anything of it is kept."""
    key = "code_hash" if record.kind == "runs" else "program_hash"
    apart, wrong = differing_channels(apart), faults(record)
    cause = None
    if apart or wrong:
        cause = cause_of(then, now, key, wrong, store)
    same = then.get(key) == now[key]
    return Rerun(record.id, record.kind, apart, same, cause, describe_uncommitted(then))


def _run_apart(
    record: StoredRecord, store: Path, manifest: Mapping, simulated
) -> tuple:
    # Past the check of the hash: what was changed is to be found, not only refused.
    stored = to_arrays(read_parquet(record.folder / SAMPLES_FILE))
    names = ("t", "q", "qd", "qdd", "tau", "q_ref")
    logged = {name: getattr(simulated.log, name) for name in names}
    logged = {k: v for k, v in logged.items() if v is not None}
    apart = compare_channels(stored, {**logged, **simulated.twin})
    if data_hash(simulated.truth) == manifest["truth_hash"]:
        return apart
    # Which of its channels would tell what is hidden.
    return (*apart, Channel(_TRUTH, "", False, note="other values"))


def _check_imported(
    record: StoredRecord, store: Path, manifest: Mapping, verify: bool
) -> Rerun:
    if not verify:
        raise InputError(
            f"Run {record.id} was measured, not simulated: it cannot be made again. "
            f"modelgap rerun {record.id[:8]} --verify checks its values against their "
            "hash."
        )
    wrong = faults(record)
    cause = Cause("damaged", "; ".join(wrong)) if wrong else None
    known = describe_uncommitted(manifest["provenance"])
    return Rerun(record.id, record.kind, (), True, cause, known, imported=True)


def _note(store: Path, outcome: Rerun, robot: str, new: str | None) -> str | None:
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
    parents = {RERUN_OF: [outcome.id], **({KIND: [new]} if new else {})}
    return commit_record(store, "validations", record, parents=parents)


# A model, diagnosis or validation once more, from its request and its ancestors.
#
# It is made in a store of its own for the time being, in which there is nothing but
# what the first one was made from: so it can depend on nothing else, and nothing is
# written where the first one is.


@contextmanager
def made_again(
    store: Path, record: StoredRecord
) -> Iterator[tuple[Path, StoredRecord]]:
    """Make a record once more.

    Yields:
        A store for the time being, and the new record in it.
    """
    request = read_record(store, record.id).get("request") or {}
    step = _STEPS.get(request.get("step"))
    if step is None:
        raise InputError(
            f"{record.id} ({record.kind}) does not say how it was made, so it cannot "
            "be made again. Records of identify, calibrate, diagnose, validate and "
            "monitor by this version do."
        )
    before = [each for each in with_parents(store, record.id) if each.id != record.id]
    with TemporaryDirectory(prefix="modelgap-rerun-") as folder:
        own = Path(folder).resolve()
        _link(store, own, before, _tracks(store, record))
        with instead(_robots(store, request, before)):
            verb, make = step
            make(verb.from_record(request, own))
        new = _counterpart(own, record, {each.id for each in before})
        yield own, new


def apart(record: StoredRecord, other: StoredRecord) -> tuple[Channel, ...]:
    """Return where two records of one kind differ, value by value."""
    one, two = read_row(record), read_row(other)
    out = compare_values(json.loads(one["record"]), json.loads(two["record"]), "")
    old, new = (list_tables(each) | _parquets(each) for each in (record, other))
    for name in old | new:
        out += _table_apart(name, old.get(name), new.get(name))
    old, new = _bytes(record), _bytes(other)
    out += [
        Channel(name, "", False, note="another file")
        for name in old | new
        if old.get(name) != new.get(name)
    ]
    return tuple(out)


def keep_record(own: Path, store: Path, old: StoredRecord, new: StoredRecord) -> str:
    """Put a record that was made again, and what was made with it, into the store.

    Returns:
        The id that the new one has in the store; the first one is its parent.
    """
    renamed: dict[str, str] = {}
    for each in with_parents(own, new.id):
        if has_record(store / each.folder.relative_to(own)):
            continue
        row = read_row(each)
        parents = [(p["parent"], p["role"]) for p in row["lineage"] or []]
        parents = [(renamed.get(id, id), role) for id, role in parents]
        if each.id == new.id:
            parents.append((old.id, RERUN_OF))
        text = row["record"]
        for before, after in renamed.items():
            text = text.replace(before, after)
        tables = {k: t for k, t in list_tables(each).items() if len(t)}
        tables |= _parquets(each)
        renamed[each.id] = commit_record(
            store, each.kind, json.loads(text), tables, parents, _bytes(each)
        )
    return renamed[new.id]


def _link(store: Path, own: Path, before: Sequence[StoredRecord], sealed: bool) -> None:
    """Let a store have some records of another one."""
    for each in before:
        _share(each.folder, own / each.folder.relative_to(store))
        seal = Path(SEALED) / f"run_id={each.id}"
        if sealed and has_record(store / seal):
            _share(store / seal, own / seal)


def _share(folder: Path, target: Path) -> None:
    target.mkdir(parents=True)
    fetch_record(folder)
    for path in folder.iterdir():
        # A symbolic link would not do: SQL follows it out of the store and refuses.
        try:
            os.link(path, target / path.name)
        except OSError:
            shutil.copyfile(path, target / path.name)


def _tracks(store: Path, record: StoredRecord) -> bool:
    """Whether a record was made with the hidden half of a run: feed-forward is."""
    kind = read_record(store, record.id).get("kind") or ""
    return record.kind == "validations" and "feed_forward" in kind


def _counterpart(own: Path, record: StoredRecord, before: set[str]) -> StoredRecord:
    new = [id for id in list_folders(own, record.kind) if id not in before]
    if len(new) != 1:
        raise InputError(
            f"Making {record.id} again gave {len(new)} records of {record.kind}, "
            "expected 1. Its request does not fit this version of the program."
        )
    return find(own, new[0])


def _robots(
    store: Path, request: Mapping, before: Sequence[StoredRecord]
) -> dict[str, str]:
    """Return where to load each robot from, such that it is the one that was used."""
    runs = [read_manifest(store, each.id) for each in before if each.kind == "runs"]
    known = [
        (record.get("robot"), record.get("robot_hash")) for record in (*runs, request)
    ]
    return {word: robot_word(store, word, hash) for word, hash in known if word}


def _identify(request: Identify) -> None:
    words = [*request.logs, *request.held_out]
    files = [w for w in words if len(w) < ID_DIGITS or set(w) - set("0123456789abcdef")]
    if files:
        raise InputError(
            f"It was identified from the file {files[0]}, which is not in the store. "
            "Import the log (modelgap import) and identify from the run."
        )
    identify.identify(request, identify.read_logs(request))


def _calibrate(request: Calibrate) -> None:
    logs, runs = calibrate.read_logs(request)
    if request.paper:
        runs = with_twins(logs.robot, runs)
    calibrate.calibrate(request, logs, runs)


# Of each verb its request, and what does it.
_STEPS: Mapping[str, tuple[type[Request], Callable]] = {
    "diagnose": (Diagnose, diagnose_runs),
    "identify": (Identify, _identify),
    "calibrate": (Calibrate, _calibrate),
    "validate": (Validate, validate),
    "monitor": (Monitor, monitor),
}


def _parquets(record: StoredRecord) -> dict:
    paths = other_files(record).values()
    return {p.stem: read_parquet(p) for p in paths if p.suffix == ".parquet"}


def _bytes(record: StoredRecord) -> dict[str, bytes]:
    paths = other_files(record).values()
    return {p.name: p.read_bytes() for p in paths if p.suffix != ".parquet"}


def _table_apart(name: str, one: pa.Table | None, two: pa.Table | None) -> list:
    """Return where two tables differ, column by column."""
    if one is None or two is None or one.schema != two.schema or len(one) != len(two):
        hashes = [None if side is None else table_hash(side) for side in (one, two)]
        note = "another number of rows or other columns"
        same = hashes[0] == hashes[1]
        return [] if same else [Channel(name, "", False, note=note)]
    out = []
    for column, a, b in zip(one.column_names, one.columns, two.columns, strict=True):
        at, types = f"{name}.{column}", (a.type, b.type)
        if all(map(pa.types.is_floating, types)):
            sides = [c.to_numpy(zero_copy_only=False) for c in (a, b)]
            (channel,) = compare_channels({at: sides[0]}, {at: sides[1]})
            out += [] if channel.equal else [channel]
        elif not a.equals(b):
            out.append(Channel(at, "", False, len(one), note="other values"))
    return out
