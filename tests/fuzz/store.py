"""Readers of the store: SQL, and bundles from another machine."""

import atexit
import hashlib
import io
import json
import shutil
import tarfile
import tempfile
from functools import cache
from pathlib import Path

from hypothesis import strategies as st

from benchmarks.store_parts.made import records, run
from flows.report.answers import as_bytes
from residual.errors import InputError
from tests.checkout import listing
from tests.fuzz.mutation import Draw, changed, flipped, mutated
from tests.fuzz.reader import Reader
from warehouse.bundle import CONTENTS, read_bundle, write_bundle
from warehouse.layout import list_folders
from warehouse.query.store import Store, open_store
from warehouse.verify import verify_all

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
    """A store with two runs, a model, a diagnosis and a report."""
    place = Path(tempfile.mkdtemp(prefix="modelgap-fuzz-store-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    records(place, [run(place, seed) for seed in range(2)])
    return place


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
                content = as_bytes(rows, form)
            except InputError:
                continue  # of two columns with one name
            if form == "json":
                assert len(json.loads(content, parse_constant=_no)) == len(rows)
    finally:
        assert listing(_origin()) == before, "a query has changed the store"


def _no(word: str) -> None:
    raise AssertionError(f"{word} is no JSON")


@cache
def _bundle() -> bytes:
    origin = _origin()
    (report,) = list_folders(origin, "reports")
    with tempfile.TemporaryDirectory() as place:
        write_bundle(origin, report, Path(place) / "good.tar")
        return (Path(place) / "good.tar").read_bytes()


def _unbundle(data: bytes, place: Path) -> None:
    file, store = place / "bundle.tar", place / "store"
    file.write_bytes(data)
    try:
        read_bundle(file, store)
    except InputError:
        kept = [p for p in store.rglob("*") if p.is_file()] if store.exists() else []
        assert kept == [], "a bundle that was refused has left something"
        raise
    faults = [line for each in verify_all(store) for line in each.faults]
    assert faults == []
    outside = {p.name for p in place.iterdir()} - {"bundle.tar", "store"}
    assert outside == set()


@cache
def _members() -> dict[str, bytes]:
    with tarfile.open(fileobj=io.BytesIO(_bundle())) as tar:
        return {m.name: tar.extractfile(m).read() for m in tar}


@st.composite
def _repacked(draw: Draw) -> bytes:
    """A bundle whose sums hold though a file, a name or the list was changed."""
    files = {name: data for name, data in _members().items() if name != CONTENTS}
    contents = json.loads(_members()[CONTENTS])
    name = draw(st.sampled_from(sorted(files)))
    kind = draw(st.sampled_from(("content", "content", "name", "list", "gone")))
    if kind == "content":
        files[name] = draw(flipped([files[name]]))
    elif kind == "name":
        files[draw(st.sampled_from(_NAMES)).format(name)] = files.pop(name)
    elif kind == "gone":
        del files[name]
    contents["files"] = {
        n: {"sha256": hashlib.sha256(d).hexdigest(), "bytes": len(d)}
        for n, d in files.items()
    }
    if kind == "list":
        contents = draw(changed([contents]))
    return _tar({CONTENTS: json.dumps(contents).encode(), **files})


_NAMES = ("../{}", "/{}", "{}/x", "./{}", "{}\n", "x", "_index/{}", "{}.json")


def _tar(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", errors="surrogatepass") as tar:
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    return out.getvalue()


STORES = (
    Reader("sql", lambda: mutated(_QUERIES, _SQL_WORDS), lambda: _QUERIES, _ask),
    Reader(
        "bundle",
        lambda: st.one_of(_repacked(), flipped([_bundle()])),
        lambda: [_bundle()],
        _unbundle,
    ),
)
