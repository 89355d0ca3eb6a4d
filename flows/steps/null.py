"""A null of one robot, log plan and noise: made over all cores, kept, found again.

Blocks of draws are the same for the same seed, so what an interrupted run finished is
kept as a smaller null, and the same command goes on from there.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

from flows.inputs.given import LogSets, read_logs
from flows.outputs import Progress
from flows.requests import Null as Request
from flows.settings import cores, store_folder
from flows.storage.null import KIND, method_hash, null_records
from flows.workers.pool import Pool, Runs, plainly
from residual.errors import InputError
from residual.lazy import one_blas_thread
from residual.method.null_record import Null, from_record
from residual.method.nulls import block, source
from warehouse.commit import commit_record
from warehouse.ids import data_hash

OF_A_BLOCK = 4  # draws that share their encoder noise


@dataclass(frozen=True, eq=False, slots=True)
class Made:
    """A null and where it is kept."""

    null: Null
    known: int  # how many of its draws were in the store already
    complete: bool  # whether all draws that were asked for are in it


def calibrate_null(
    asked: Request,
    progress: Progress | None = None,
    pool: Runs | None = None,
    workers: int | None = None,
) -> Made:
    """Make the draws that are not in the store, and keep the null there.

    Interrupted, it keeps what is finished and returns that, marked incomplete.
    """
    if pool is None:
        with Pool(workers or cores()) as own:
            return calibrate_null(asked, progress, own)
    sets = _read(asked)
    blocks = -(-asked.draws // OF_A_BLOCK)
    done = _begun(asked)
    known = OF_A_BLOCK * len(done)
    todo = [i for i in range(blocks) if i not in done]
    jobs = [partial(_block, asked, i) for i in todo]
    complete = True
    try:
        for count, one in enumerate(pool.run(plainly, jobs), start=1):
            if one.error:
                raise one.error
            done[todo[one.index]] = one.value
            if progress:
                progress("null recordings", count / len(todo))
    except KeyboardInterrupt:
        complete = False
        if not done:
            raise
    return Made(_keep(asked, done, tuple(sets.runs.values())), known, complete)


def _begun(asked: Request) -> dict[int, dict]:
    """Return the blocks of the same null that the store has, by number."""
    out: dict[int, dict] = {}
    identity = _identity(asked)
    for _, record in null_records(store_folder(asked.store)):
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


def _identity(asked: Request) -> dict:
    """What makes two nulls the same but for the number of draws, as JSON has it."""
    sets = _read(asked)
    logs = [data_hash({"t": r.t, "q": r.q, "tau": r.tau}) for r in sets.fit]
    return {
        "logs": logs,
        "robot": sets.robot.content_hash,
        "declared": None if asked.declared is None else list(asked.declared),
        "seed": asked.seed,
        "method": method_hash(),
    }


def _keep(asked: Request, done: Mapping[int, Mapping], ids: Sequence[str]) -> Null:
    blocks = sorted(done)
    first = done[blocks[0]]
    record = {
        "robot": _read(asked).robot.name,
        "kind": KIND,
        "asked": _identity(asked),
        "seed": asked.seed,
        "key": first["key"],
        "scale": first["scale"],
        "method": method_hash(),
        "block": [b for b in blocks for _ in done[b]["net"]],
    }
    for name in ("nats", "net", "named"):
        record[name] = [value for b in blocks for value in done[b][name]]
    parents = {"fit": list(ids)} if ids else ()
    store = store_folder(asked.store)
    id = commit_record(store, "validations", record, None, parents)
    return from_record(record, id)


@one_blas_thread
def _block(asked: Request, index: int) -> dict:
    made_after = _source(asked)
    draws = block(made_after, asked.seed, index, OF_A_BLOCK)
    key = {name: getattr(made_after.key, name) for name in made_after.key.__slots__}
    return {
        "key": json.loads(json.dumps(key)),
        "scale": made_after.scale,
        "nats": [d.nats for d in draws],
        "net": [d.net for d in draws],
        "named": [d.named for d in draws],
    }


@lru_cache(maxsize=1)
def _source(asked: Request):
    """Return what the recordings are made after; each process finds it out once."""
    sets = _read(asked)
    return source(sets.robot, sets.fit, asked.declared)


@lru_cache(maxsize=1)
def _read(asked: Request) -> LogSets:
    if asked.draws < 1:
        raise InputError(f"--draws is {asked.draws}, expected 1 or more; 200 is usual.")
    return read_logs(asked, "to calibrate for", to_check=False)
