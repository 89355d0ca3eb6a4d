"""A null of one robot, log plan and noise: made over all cores, kept, found again.

Blocks of draws are the same for the same seed, so what an interrupted run finished is
kept as a smaller null, and the same command goes on from there.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from flows.inputs.logs import read_words
from flows.inputs.robots import load
from flows.settings import cores, store_folder
from flows.steps.diagnose import Progress, check_declared
from flows.workers.pool import Here, Pool
from residual.diagnosis.null_record import Null, from_record, to_record
from residual.errors import InputError, ModelgapError
from residual.recording import Recording

KIND = "null"  # of validations
OF_A_BLOCK = 4  # draws that share their encoder noise


@dataclass(frozen=True, slots=True)
class Asked:
    """Which null is wanted.

    Attributes:
        logs: Logs: "FILE", "FILE@start:end", or ids of runs.
        robot: Built-in name, URDF file or folder.
        baseline: Logs of the robot in good order, the same way.
        declared: Effects that the model has; None for the robot's own list.
        columns: COLUMNS.toml, None for the default columns.
        draws: How many draws.
        seed: Seed of the draws.
        store: Folder of the store.
    """

    logs: tuple[str, ...]
    robot: str
    baseline: tuple[str, ...] = ()
    declared: tuple[str, ...] | None = None
    columns: str | None = None
    draws: int = 200
    seed: int = 0
    store: str | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Made:
    """A null and where it is kept.

    Attributes:
        null: The null.
        known: How many of its draws were in the store already.
        complete: Whether all draws that were asked for are in it.
    """

    null: Null
    known: int
    complete: bool


def calibrate(
    asked: Asked,
    progress: Progress | None = None,
    pool: Pool | Here | None = None,
    workers: int | None = None,
) -> Made:
    """Make the draws that are not in the store, and keep the null there.

    Interrupted, it keeps what is finished and returns that, marked incomplete.

    Args:
        asked: Which null.
        progress: Told the stage and the share done.
        pool: Processes to use; without it, own ones for the time being.
        workers: How many own processes; None for one per core.

    Raises:
        InputError: If a log is not usable, or no draw was finished.
    """
    if pool is None:
        with Pool(workers or cores()) as own:
            return calibrate(asked, progress, own)
    _, _, ids = _read(asked)
    blocks = -(-asked.draws // OF_A_BLOCK)
    done = _begun(asked)
    known = OF_A_BLOCK * len(done)
    todo = [i for i in range(blocks) if i not in done]
    jobs = [(asked, i) for i in todo]
    complete = True
    try:
        for count, one in enumerate(pool.run(_block, jobs), start=1):
            if one.error:
                raise one.error
            done[todo[one.index]] = one.value
            if progress:
                progress("null recordings", count / len(todo))
    except KeyboardInterrupt:
        complete = False
        if not done:
            raise
    return Made(_keep(asked, done, ids), known, complete)


def read_null(path: str) -> Null:
    """Read a null from a JSON file.

    Raises:
        InputError: If there is none.
    """
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"--null {path}: cannot be read, {error.strerror}.") from error
    except ValueError as error:
        raise InputError(
            f"--null {path} is no JSON, expected what modelgap calibrate-null --out "
            "wrote."
        ) from error
    if not isinstance(record, Mapping):
        raise InputError(f"--null {path} is no null, expected a JSON object.")
    return from_record(record, str(record.get("id") or Path(path).name))


def null_json(null: Null) -> str:
    """Return a null as JSON text."""
    record = {"schema": 1, "kind": KIND, "id": null.id, **to_record(null)}
    return json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n"


def nulls_in(store: Path) -> tuple[Null, ...]:
    """Return all nulls of a store, those with most draws and the latest first."""
    found = [from_record(r, id) for id, r in _records(store)]
    return tuple(sorted(found, key=lambda n: -len(n.net)))


def _records(store: Path) -> list[tuple[str, Mapping]]:
    """Return ids and records of all nulls, the latest first."""
    if not (store / "validations").is_dir():
        return []
    from warehouse.commit import read_record
    from warehouse.query.store import open_store

    query = (
        "SELECT validation_id FROM validations "
        f"WHERE kind = '{KIND}' ORDER BY created DESC"
    )
    with open_store(store) as opened:
        ids = opened.sql(query).column(0).to_pylist()
    return [(id, read_record(store, id)) for id in ids]


def _begun(asked: Asked) -> dict[int, dict]:
    """Return the blocks of the same null that the store has, by number."""
    out: dict[int, dict] = {}
    identity = _identity(asked)
    for _, record in _records(store_folder(asked.store)):
        if record["asked"] != identity:
            continue
        for number in sorted(set(record["block"])):
            rows = [i for i, b in enumerate(record["block"]) if b == number]
            draws = {
                name: [record[name][i] for i in rows]
                for name in ("nats", "net", "named")
            }
            out[number] = {"key": record["key"], "scale": record["scale"], **draws}
    return out


def _identity(asked: Asked) -> dict:
    """What makes two nulls the same but for the number of draws, as JSON has it."""
    from flows.blind.steps import method_hash
    from warehouse.ids import data_hash

    fit, baseline, _ = _read(asked)
    logs = [data_hash({"t": r.t, "q": r.q, "tau": r.tau}) for r in (*fit, *baseline)]
    return {
        "logs": logs,
        "baseline": len(baseline),
        "robot": load(asked.robot).content_hash,
        "declared": None if asked.declared is None else list(asked.declared),
        "seed": asked.seed,
        "method": method_hash(),
    }


def _keep(asked: Asked, done: Mapping[int, Mapping], ids: Sequence[str]) -> Null:
    from warehouse.commit import commit_record

    blocks = sorted(done)
    first = done[blocks[0]]
    record = {
        "robot": load(asked.robot).name,
        "kind": KIND,
        "asked": _identity(asked),
        "seed": asked.seed,
        "key": first["key"],
        "scale": first["scale"],
        "block": [b for b in blocks for _ in done[b]["net"]],
    }
    for name in ("nats", "net", "named"):
        record[name] = [value for b in blocks for value in done[b][name]]
    parents = {"fit": list(ids)} if ids else ()
    store = store_folder(asked.store)
    id = commit_record(store, "validations", record, None, parents)
    return from_record(record, id)


def _block(job: tuple[Asked, int]) -> dict:
    """Do one block; whatever it raises can cross to the parent process."""
    from threadpoolctl import threadpool_limits

    from residual.null.draws import block

    asked, index = job
    try:
        with threadpool_limits(1, user_api="blas"):
            source = _source(asked)
            draws = block(source, asked.seed, index, OF_A_BLOCK)
    except ModelgapError as error:
        raise InputError(str(error)) from None
    key = {name: getattr(source.key, name) for name in source.key.__slots__}
    return {
        "key": json.loads(json.dumps(key)),
        "scale": source.scale,
        "nats": [d.nats for d in draws],
        "net": [d.net for d in draws],
        "named": [d.named for d in draws],
    }


@lru_cache(maxsize=1)
def _source(asked: Asked):
    """Return what the recordings are made after; each process finds it out once."""
    from residual.null.source import source

    fit, baseline, _ = _read(asked)
    return source(load(asked.robot), fit, asked.declared, baseline)


@lru_cache(maxsize=1)
def _read(
    asked: Asked,
) -> tuple[tuple[Recording, ...], tuple[Recording, ...], tuple[str, ...]]:
    """Return the logs, those of the baseline, and the ids of those that are runs."""
    if not asked.logs:
        raise InputError(
            "No log to calibrate for. Name it first: modelgap calibrate-null LOG ... "
            "--robot R."
        )
    if asked.draws < 1:
        raise InputError(f"--draws is {asked.draws}, expected 1 or more; 200 is usual.")
    check_declared(asked.declared)
    words, place = (*asked.logs, *asked.baseline), store_folder(asked.store)
    logs = read_words(words, load(asked.robot), asked.columns, place)
    count = len(asked.logs)
    ids = tuple(logs.runs.values())
    return logs.recordings[:count], logs.recordings[count:], ids
