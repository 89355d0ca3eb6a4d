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
class CalibratedNull:
    """A null and where it is kept."""

    null: Null
    known: int  # how many of its draws were in the store already
    complete: bool  # whether all draws that were asked for are in it


def calibrate_null(
    request: Request,
    progress: Progress | None = None,
    pool: Runs | None = None,
    workers: int | None = None,
) -> CalibratedNull:
    """Make the draws that are not in the store, and keep the null there.

    Interrupted, it keeps what is finished and returns that, marked incomplete.
    """
    if pool is None:
        with Pool(workers or cores()) as own:
            return calibrate_null(request, progress, own)
    sets = _read(request)
    blocks = -(-request.draws // OF_A_BLOCK)
    done = _begun(request)
    known = OF_A_BLOCK * len(done)
    todo = [i for i in range(blocks) if i not in done]
    jobs = [partial(_block, request, i) for i in todo]
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
    return CalibratedNull(
        _keep(request, done, tuple(sets.runs.values())), known, complete
    )


def _begun(request: Request) -> dict[int, dict]:
    """Return the blocks of the same null that the store has, by number."""
    out: dict[int, dict] = {}
    identity = _identity(request)
    for _, record in null_records(store_folder(request.store)):
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


def _identity(request: Request) -> dict:
    """What makes two nulls the same but for the number of draws, as JSON has it."""
    sets = _read(request)
    logs = [data_hash({"t": r.t, "q": r.q, "tau": r.tau}) for r in sets.fit]
    return {
        "logs": logs,
        "robot": sets.robot.content_hash,
        "declared": None if request.declared is None else list(request.declared),
        "seed": request.seed,
        "method": method_hash(),
    }


def _keep(request: Request, done: Mapping[int, Mapping], ids: Sequence[str]) -> Null:
    blocks = sorted(done)
    first = done[blocks[0]]
    record = {
        "robot": _read(request).robot.name,
        "kind": KIND,
        "asked": _identity(request),
        "seed": request.seed,
        "key": first["key"],
        "scale": first["scale"],
        "method": method_hash(),
        "block": [b for b in blocks for _ in done[b]["net"]],
    }
    for name in ("nats", "net", "named"):
        record[name] = [value for b in blocks for value in done[b][name]]
    parents = {"fit": list(ids)} if ids else ()
    store = store_folder(request.store)
    id = commit_record(store, "validations", record, None, parents)
    return from_record(record, id)


@one_blas_thread
def _block(request: Request, index: int) -> dict:
    made_after = _source(request)
    draws = block(made_after, request.seed, index, OF_A_BLOCK)
    key = {name: getattr(made_after.key, name) for name in made_after.key.__slots__}
    return {
        "key": json.loads(json.dumps(key)),
        "scale": made_after.scale,
        "nats": [d.nats for d in draws],
        "net": [d.net for d in draws],
        "named": [d.named for d in draws],
    }


@lru_cache(maxsize=1)
def _source(request: Request):
    """Return what the recordings are made after; each process finds it out once."""
    sets = _read(request)
    return source(sets.robot, sets.fit, request.declared)


@lru_cache(maxsize=1)
def _read(request: Request) -> LogSets:
    if request.draws < 1:
        raise InputError(
            f"--draws is {request.draws}, expected 1 or more; 200 is usual."
        )
    return read_logs(request, "to calibrate for", to_check=False)
