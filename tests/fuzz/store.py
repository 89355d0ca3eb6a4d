"""The reader of the store: SQL."""

import atexit
import json
import shutil
import tempfile
from functools import cache
from pathlib import Path

import pyarrow as pa

from benchmarks.store_parts.records import small
from flows.report.records import encode_query_result
from residual.errors import InputError
from tests.checkout import listing
from tests.fuzz.mutation import mutated
from tests.fuzz.reader import Reader
from warehouse.queries import Store, open_store
from warehouse.record_commit import SealedTruth, commit_record, commit_run

_QUERIES = [
    text.encode()
    for text in (
        "SELECT robot, count(*) AS n FROM runs GROUP BY ALL ORDER BY n DESC LIMIT 5",
        "SELECT run_id, avg(q1), max(tau6) FROM samples WHERE t > 0.05 GROUP BY run_id",
        "WITH a AS (SELECT * FROM runs) SELECT a.run_id, e.name FROM a "
        "LEFT JOIN effects e ON e.diagnosis_id = a.run_id",
        "FROM diagnoses SELECT json_extract('[{\"x\": 1}]', '$[0].x') AS x, verdict",
        "EXPLAIN ANALYZE SELECT count(*) FROM samples",
        "SELECT i, 'a' || i, i::DOUBLE / 0, [i], {'x': i}, NULL, DATE '2026-01-01', "
        "INTERVAL 1 DAY, 1.5::DECIMAL(5, 2), '\\x00'::BLOB FROM range(3) t(i)",
        "SELECT * FROM (VALUES (1, 'x'), (2, NULL)) v(a, b) WHERE a IN (SELECT 1)",
        "SELECT row_number() OVER (PARTITION BY robot ORDER BY created) FROM runs",
        "PIVOT (SELECT robot, dof FROM runs) ON dof IN (6) USING count(*)",
    )
]
_SQL_WORDS = tuple(
    b"SELECT FROM WHERE GROUP BY ALL ORDER LIMIT JOIN UNION EXCEPT WITH RECURSIVE AS "
    b"VALUES EXPLAIN ANALYZE COPY TO INSERT INTO CREATE TABLE VIEW ATTACH SET PRAGMA "
    b"CALL INSTALL LOAD PIVOT UNPIVOT DESCRIBE SUMMARIZE SHOW USE runs samples effects "
    b"signals catalogue.runs information_schema.tables read_parquet glob read_text "
    b"getenv current_setting query unnest range generate_series repeat list * :: $1 "
    b"$x ? ; -- /* */ ( ) 'x' \"x\" 1e400 NULL CAST DISTINCT QUALIFY TABLESAMPLE "
    b"COLUMNS(*) lambda -> [1] {} INTERVAL DATE HUGEINT BIT UUID BLOB ENUM".split()
)


@cache
def _origin() -> Path:
    place = Path(tempfile.mkdtemp(prefix="modelgap-fuzz-store-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    runs = {"fit": [_commit_run(place, seed) for seed in range(2)]}
    table = {"curve": pa.table({"x": [0.5, 1.5, 2.5]})}
    about = {"robot": "irb140", "stage": "augmented"}
    model = commit_record(place, "models", about, table, runs)
    verdict = {"robot": "irb140", "verdict": "effects", "model_id": model}
    diagnosis = commit_record(place, "diagnoses", verdict, None, runs)
    report = {"report.html": b"<html></html>"}
    about = {"robot": "irb140", "kind": "demo"}
    commit_record(place, "reports", about, None, [diagnosis], report)
    return place


def _commit_run(place: Path, seed: int) -> str:
    log, manifest, twin = small(seed)
    sealed = SealedTruth({"effects": [], "salt": f"s{seed}"}, {"q": log.q})
    return commit_run(place, log, manifest, sealed, twin)


@cache
def _opened() -> tuple[Store, dict]:
    opened = open_store(_origin())
    atexit.register(_opened.cache_clear)
    atexit.register(opened.close)
    opened.sql("SELECT count(*) FROM samples")
    return opened, listing(_origin())


def _ask(data: bytes, place: Path) -> None:
    opened, before = _opened()
    text = data.decode("utf-8", errors="surrogateescape")
    try:
        rows = opened.sql(text, timeout=5)
        for form in ("json", "csv", "table", "parquet"):
            try:
                content = encode_query_result(rows, form)
            except InputError:
                continue  # of two columns with one name
            if form == "json":
                assert len(json.loads(content, parse_constant=_no)) == len(rows)
    finally:
        assert listing(_origin()) == before, "a query has changed the store"


def _no(word: str) -> None:
    raise AssertionError(f"{word} is no JSON")


STORES = (Reader("sql", lambda: mutated(_QUERIES, _SQL_WORDS), lambda: _QUERIES, _ask),)
