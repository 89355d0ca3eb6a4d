"""A store on object storage: writers at once, kills, ten thousand runs, what it costs.

The server is moto in a process of its own, on this machine. The runs are synthetic
samples of six joints, put in by the program's own commit; nothing is simulated.
"""

import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial as call
from pathlib import Path
from statistics import median
from urllib.request import urlopen

from boto3 import client

import warehouse
from benchmarks.harness.figures import Figures, figure, missing, partial
from benchmarks.harness.rates import wall
from benchmarks.harness.shell import forked, free_port, wait_for
from benchmarks.store_parts.made import run, synthetic
from warehouse.bucket import Bucket
from warehouse.commit import commit_run
from warehouse.files import to_table, write_parquet
from warehouse.layout import list_folders
from warehouse.remote import CACHE, bucket_of, forget_buckets, local_folder
from warehouse.runs import read_run
from warehouse.verify import verify_all

_ROWS = 5_000  # 20 s at 250 Hz, 43 columns
_FILLERS = 4


@dataclass(frozen=True, slots=True)
class Costs:
    """Times [s] and ratios of pairs, medians."""

    commit: float  # a commit
    put: float  # a put of one object with as many bytes
    ratio: float  # the first over the second
    # A commit over making the Parquet file of the samples and a put
    over_parquet: float


def one_winner(address: str, writers: int, runs: int) -> list[int]:
    """Let several processes write the same runs; return how many wrote each."""
    with forked(__name__).Pool(writers) as pool:
        wrote = pool.starmap(_write_all, [(address, range(runs))] * writers, 1)
    counts = Counter(id for ids in wrote for id in ids)
    store = local_folder(address)
    if set(counts) != set(list_folders(store, "runs")):
        return [0]
    return list(counts.values())


def killed(address: str, kills: int) -> tuple[int, int]:
    """Kill a writer again and again; return what is partial then, and all runs."""
    rng, context = random.Random(7), forked(__name__)
    first, usual = 0, _usual_commit(address)
    for _ in range(kills):
        started = context.Event()
        work = (address, first, started)
        process = context.Process(target=_write_until_killed, args=work)
        process.start()
        # One run is stored then; it is killed somewhere in the next three.
        started.wait()
        time.sleep(rng.uniform(0, 3 * usual))
        process.kill()
        process.join()
        first += 2
    own_copies()
    store = local_folder(address)
    broken = {(v.kind, v.id) for v in verify_all(store) if v.faults}
    with warehouse.open(address) as opened:
        ids = opened.sql("SELECT run_id FROM runs").column(0).to_pylist()
        rows = opened.sql("SELECT run_id, count(*) AS n FROM samples GROUP BY run_id")
        broken |= {("runs", r["run_id"]) for r in rows.to_pylist() if r["n"] != 50}
    for id in ids:
        read_run(store, id)
    return len(broken), len(ids)


def _usual_commit(address: str) -> float:
    """Return how long a commit takes here [s]."""
    store = local_folder(address)
    return median(wall(call(run, store, 10**6 + seed)) for seed in range(6))


def timed_questions(address: str, runs: int) -> dict[str, float]:
    """Fill a store and time questions of a machine that has no copies yet [s]."""
    parts = [(address, range(k, runs, _FILLERS)) for k in range(_FILLERS)]
    with forked(__name__).Pool(_FILLERS) as pool:
        pool.starmap(_write_all, parts, 1)
    with warehouse.open(address) as opened:
        # What the last writers left is added once, by whoever comes first.
        assert opened.sql("SELECT count(*) AS n FROM runs")["n"][0].as_py() == runs
    listing = "SELECT run_id, robot, created FROM runs ORDER BY created"
    errors = "SELECT joint, metric, avg(value) AS v FROM errors GROUP BY ALL"
    own_copies()
    out = {"list": _asked(address, listing), "list_again": _asked(address, listing)}
    own_copies()
    return out | {"errors": _asked(address, errors)}


def paired_commits(address: str, pairs: int) -> Costs:
    """Time commits of runs of 20 s, each beside a put of one object of that size."""
    store, times = local_folder(address), []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(pairs + 2):
            log, twin = synthetic(seed, _ROWS)
            arrays = {"t": log.t, "q": log.q, "tau": log.tau, "q_ref": log.q_ref} | twin
            about = {"robot_hash": "0" * 64}
            commit = wall(call(commit_run, store, log, about, extra=twin))
            bucket = bucket_of(store)
            put = wall(call(bucket.put, f"bare/{seed}", os.urandom(_size(bucket))))
            path = Path(folder, f"{seed}.parquet")
            made = wall(lambda p=path, a=arrays: write_parquet(p, to_table(a, {})))
            times.append((commit, put, made))
    # The first ones make connections, and load what a process loads once.
    times = times[2:]
    return Costs(
        median(commit for commit, _, _ in times),
        median(put for _, put, _ in times),
        median(commit / put for commit, put, _ in times),
        median(commit / (put + made) for commit, put, made in times),
    )


def own_copies() -> None:
    """Forget what this process knows, and keep copies in a new folder."""
    os.environ[CACHE] = tempfile.mkdtemp(dir=Path(os.environ[CACHE]))
    forget_buckets()


def _asked(address: str, query: str) -> float:
    def asked() -> None:
        with warehouse.open(address) as opened:
            opened.sql(query)

    return wall(asked)


def _write_all(address: str, seeds: range) -> list[str]:
    """Commit runs; return the ids of those of which this is the one that is stored."""
    own_copies()
    store, wrote = local_folder(address), []
    publish = warehouse.commit.publish

    def watched(folder: Path, target: Path) -> bool:
        first = publish(folder, target)
        if first and target.parent.parent.name == "samples":
            wrote.append(target.name.removeprefix("run_id="))
        return first

    warehouse.commit.publish = watched
    try:
        for seed in seeds:
            run(store, seed)
    finally:
        warehouse.commit.publish = publish
    return wrote


def _write_until_killed(address: str, first: int, started) -> None:
    own_copies()
    store = local_folder(address)
    for seed in range(first, first + 1000):
        run(store, seed)
        started.set()


def _size(bucket: Bucket) -> int:
    keys = bucket.keys("samples")
    sizes: Counter = Counter()
    for key in keys[-4:]:  # of one of the last
        sizes[key.rpartition("/")[0]] += len(bucket.get(key) or b"")
    return max(sizes.values())


_PATIENCE = 60.0  # s until it must answer
_KEYS = {
    "AWS_ACCESS_KEY_ID": "benchmark",
    "AWS_SECRET_ACCESS_KEY": "benchmark",
    "AWS_REGION": "us-east-1",
}


@contextmanager
def serve(folder: Path) -> Iterator[Callable[[], str]]:
    """Serve S3; gives a function that returns the address of a new store."""
    port = free_port()
    words = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", port]
    process = subprocess.Popen(
        words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    endpoint = f"http://127.0.0.1:{port}"
    os.environ.update(_KEYS, AWS_ENDPOINT_URL=endpoint, MODELGAP_CACHE=str(folder))
    try:
        if not wait_for(lambda: _answers(endpoint), _PATIENCE, 0.2):
            raise TimeoutError(f"{endpoint} does not answer.")
        made = iter(range(1000))

        def new_store() -> str:
            name = f"benchmark-{next(made)}"
            s3 = client("s3", endpoint_url=endpoint, region_name="us-east-1")
            s3.create_bucket(Bucket=name)
            return f"s3://{name}/store"

        yield new_store
    finally:
        process.kill()
        process.wait()


def _answers(endpoint: str) -> bool:
    with suppress(OSError), urlopen(f"{endpoint}/moto-api/data.json", timeout=5):
        return True
    return False


WRITERS, TOGETHER, KILLS, MANY, PAIRS = 8, 50, 200, 10_000, 40
_SMALL = "a quick run has fewer"


def object_figures(quick: bool) -> Figures:
    share = 20 if quick else 1
    with tempfile.TemporaryDirectory() as folder, serve(Path(folder)) as new_store:
        together = TOGETHER // share
        won = one_winner(new_store(), WRITERS, together)
        print(f"{WRITERS} writers x {together} runs: winners {sorted(set(won))}")
        kills = KILLS // share
        partly, seen = killed(new_store(), kills)
        print(f"{kills} kills: {seen} runs stored, {partly} partial")
        count = 120 if quick else MANY
        times = timed_questions(new_store(), count)
        print(f"{count} runs: {times}")
        pairs = PAIRS // (4 if quick else 1)
        costs = paired_commits(new_store(), pairs)
        print(f"commit {costs.commit:.3f} s, put of the same bytes {costs.put:.3f} s")
    alone = {"ok": set(won) == {1}, "writers": WRITERS}
    made = {
        "object_winners_per_run": figure(max(won), 1, together, **alone),
        "object_partial_after_kills": figure(partly, 0, kills, runs=seen),
        "object_list_s": figure(times["list"], 1.0, count, again=times["list_again"]),
        "object_errors_s": figure(times["errors"], 2.0, count),
        "object_commit_ratio": figure(
            costs.ratio, 2.0, pairs, commit_s=costs.commit, put_s=costs.put
        ),
        "object_commit_over_parquet_and_put": figure(costs.over_parquet, None, pairs),
    }
    if not quick:
        return made
    out = {name: partial(entry, _SMALL) for name, entry in made.items()}
    for name in ("object_list_s", "object_errors_s"):
        out[name] = missing(made[name]["bar"], f"{count} runs only")
    return out
