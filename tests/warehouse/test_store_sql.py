"""SQL over the store: what it shows, and what it cannot do."""

import shutil
import threading

import duckdb
import pyarrow.parquet as pq
import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as samples
from tests.warehouse.store_samples import ask
from warehouse import view_schema
from warehouse.queries import open_store
from warehouse.record_commit import commit_run
from warehouse.sql_guard import NAMED, TAKES
from warehouse.store_catalogue import find_run, quarantine_run, read_quarantine_reason, read_run
from warehouse.store_files import write_check_sums


def listing(folder):
    files = {p: p.stat() for p in folder.rglob("*") if p.is_file()}
    return {p: (stat.st_size, stat.st_mtime_ns) for p, stat in files.items()}


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A store with three runs of two kinds of motion; not to be changed."""
    folder = tmp_path_factory.mktemp("template") / "the store's"
    for seed, kind in enumerate(("fourier", "fourier", "welding")):
        samples.commit(folder, seed, kind)
    return folder


@pytest.fixture
def store(template, tmp_path):
    return shutil.copytree(template, tmp_path / template.name)


@pytest.fixture(scope="module")
def opened(template):
    with open_store(template) as store:
        yield store


@pytest.mark.parametrize("full", [False, True])
def test_every_view_has_the_columns_and_types_of_the_schema(tmp_path, store, full):
    folder = store if full else tmp_path / "empty"
    folder.mkdir(exist_ok=True)
    with open_store(folder) as opened:
        for view, columns in view_schema.list_views().items():
            rows = opened.sql(f"FROM {view}")
            assert rows.column_names == [c.name for c in columns]
            assert rows.schema.types == [c.type for c in columns]
            assert bool(rows.num_rows) == (full and view in HELD)


HELD = {"runs", "samples", "channels", "errors"}


def test_every_named_query_runs_in_an_empty_store(tmp_path):
    with open_store(tmp_path) as opened:
        for name, (_, query) in NAMED.items():
            given = dict.fromkeys(TAKES.get(name, {}), "a")
            assert opened.sql(query, given).num_rows == 0, name


def test_samples_of_robots_with_other_channels_stand_side_by_side(store):
    bare = commit_run(store, samples.recording(7, robot="bare"), {"robot_hash": "ab"})
    rows = ask(
        store,
        "SELECT robot, count(*) n, count(q_ref1) q_ref, count(q3) q3, sum(q1) q1 "
        "FROM samples GROUP BY robot ORDER BY robot",
    )
    assert [(r["robot"], r["n"], r["q_ref"], r["q3"]) for r in rows] == [
        ("bare", 50, 0, 0),
        ("two_link", 150, 150, 0),
    ]
    assert rows[0]["q1"] == pytest.approx(samples.recording(7).q[:, 0].sum(), rel=1e-12)
    query = f"SELECT DISTINCT run_id FROM samples WHERE run_id = '{bare}'"
    assert ask(store, query) == [{"run_id": bare}]


def test_an_id_of_digits_alone_stays_a_text(store):
    folder = find_run(store, ask(store, "FROM runs")[0]["run_id"]).folder
    for digits in ("00000000000000000012", "1" * 20, "1e10".zfill(20)):
        shutil.copytree(folder, folder.with_name(f"run_id={digits}"))
        path = folder.with_name(f"run_id={digits}") / "_run.parquet"
        row = pq.read_table(path)
        pq.write_table(row.set_column(0, row.field(0), [[digits]]), path)
        write_check_sums(path.parent)
    ids = [r["run_id"] for r in ask(store, "SELECT DISTINCT run_id FROM samples")]
    assert {"00000000000000000012", "1" * 20, "1e10".zfill(20)} < set(ids)


def test_the_errors_of_the_twin_are_those_of_the_samples(store):
    stated = ask(
        store,
        "SELECT run_id, value FROM errors WHERE stage = 'twin' AND joint = 2 "
        "AND metric = 'rms_e_tau' ORDER BY run_id",
    )
    counted = ask(
        store,
        "SELECT run_id, sqrt(avg(e_tau2 ** 2)) AS value FROM samples "
        "GROUP BY run_id ORDER BY run_id",
    )
    assert [r["run_id"] for r in stated] == [r["run_id"] for r in counted]
    assert [r["value"] for r in stated] == pytest.approx([r["value"] for r in counted])


def test_an_opened_store_sees_what_is_committed_and_quarantined_since(store):
    with open_store(store) as opened:
        count = "SELECT count(*) n FROM runs WHERE NOT quarantined"
        assert opened.sql(count).to_pylist() == [{"n": 3}]
        id = samples.commit(store, 8)
        assert opened.sql(count).to_pylist() == [{"n": 4}]
        assert opened.sql(f"FROM samples WHERE run_id = '{id}'").num_rows == 50
        path = quarantine_run(store, id[:10], "gripper was loose")
        assert path == store / "quarantine" / f"run_id={id}.json"
        assert quarantine_run(store, id, "another reason") == path
        assert read_quarantine_reason(store, id) == "gripper was loose"
        assert opened.sql(count).to_pylist() == [{"n": 3}]
        assert opened.sql("FROM runs").num_rows == 4
    with pytest.raises(InputError, match="needs a reason"):
        quarantine_run(store, id, " ")


READING = [
    "SELECT 1",
    "select 1;",
    "  /* why */ SELECT count(*) FROM runs -- all of them",
    "FROM runs SELECT run_id ORDER BY created DESC LIMIT 1",
    "WITH a AS (FROM runs), b AS MATERIALIZED (FROM a) SELECT count(*) FROM a, b",
    "WITH RECURSIVE f(n) AS (SELECT 1 UNION SELECT n + 1 FROM f WHERE n < 5) FROM f",
    "SELECT run_id, t - lag(t) OVER (PARTITION BY run_id ORDER BY t) FROM samples",
    "VALUES (1), (2)",
    "DESCRIBE runs",
    "SUMMARIZE runs",
    "SHOW TABLES",
    "EXPLAIN SELECT 1",
    "EXPLAIN /* é */ ANALYZE SELECT 'é' FROM runs",
    "EXPLAIN (FORMAT json) SELECT 1",
    "FROM (PIVOT runs ON trajectory IN ('fourier') USING count(*))",
    "SELECT unnest([1, 2]), * FROM range(3)",
    "SELECT a.t FROM samples a ASOF JOIN samples b ON a.t >= b.t",
    "SELECT list_transform([1, 2], lambda x: x + 1)",
    "SELECT 'COPY runs TO x; DROP TABLE runs'",
]


@pytest.mark.parametrize("query", READING)
def test_what_reads_runs(opened, query):
    assert opened.sql(query).num_rows >= 1


# What each is told; STORE stands for the folder.
REFUSED = {
    "": "no statements",
    " ; ": "no statements",
    "-- nothing": "no statements",
    "SELEC 1": "syntax error",
    "SELECT 1; SELECT 2": "got 2 statements",
    "SELECT 1; DROP TABLE catalogue.runs": "got 2 statements",
    "CREATE TABLE a (i INTEGER)": "got CREATE",
    "CREATE MACRO a(x) AS x": "got CREATE",
    "INSERT INTO catalogue.runs (run_id) VALUES ('a')": "got INSERT",
    "UPDATE catalogue.runs SET seed = 1": "got UPDATE",
    "DELETE FROM catalogue.runs": "got DELETE",
    "DROP VIEW runs": "got DROP",
    "COPY runs TO 'x.csv'": "got COPY",
    "COPY runs TO 'STORE/samples/x.parquet'": "got COPY",
    "COPY (SELECT 1) TO 'STORE/_index/runs.parquet'": "got COPY",
    "EXPORT DATABASE 'STORE/samples'": "got EXPORT",
    "IMPORT DATABASE 'STORE/samples'": "got",
    "ATTACH 'STORE/samples/x.duckdb'": "got ATTACH",
    "DETACH memory": "got DETACH",
    "INSTALL httpfs": "got LOAD",
    "LOAD httpfs": "got LOAD",
    "PRAGMA database_list": "got PRAGMA",
    "SET enable_external_access = true": "got",
    "RESET lock_configuration": "got",
    "USE catalogue": "got",
    "CALL enable_logging()": "got CALL",
    "CHECKPOINT": "got CALL",
    "VACUUM": "got VACUUM",
    "BEGIN": "got TRANSACTION",
    "PREPARE a AS SELECT 1": "got PREPARE",
    "EXECUTE a": "got EXECUTE",
    "CONNECT 'x'": "got something else",
    "PIVOT runs ON robot USING count(*)": "needs its values",
    # Types SELECT and EXPLAIN, and yet they write.
    "WITH x AS (COPY (SELECT 1) TO 'STORE/samples/x.parquet') FROM x": "contains COPY",
    "WITH x AS (INSERT INTO catalogue.runs (run_id) VALUES ('a') RETURNING *) FROM x": (
        "contains INSERT"
    ),
    "WITH x AS (DELETE FROM catalogue.runs RETURNING *) FROM x": "contains DELETE",
    "EXPLAIN ANALYZE COPY (SELECT 1) TO 'STORE/samples/x.parquet'": "EXPLAIN of some",
    "EXPLAIN (ANALYZE) COPY (SELECT 1) TO 'STORE/samples/x.parquet'": "EXPLAIN of some",
    "EXPLAIN /**/ ANALYZE -- \n COPY runs TO 'STORE/samples/x.csv'": "EXPLAIN of some",
    "EXPLAIN ANALYZE WITH x AS (COPY runs TO 'STORE/samples/x.csv') FROM x": "COPY",
    "FROM json_execute_serialized_sql('SERIALISED')": "json_execute_serialized_sql()",
    "FROM system.main.JSON_execute_serialized_sql('SERIALISED')": "json_execute",
    "FROM query('SELECT 1')": "not 'query()'",
    "FROM query('FROM json_exec' || 'ute_serialized_sql(''SERIALISED'')')": "'query()'",
    "FROM checkpoint()": "not 'checkpoint()'",
    "FROM enable_logging()": "not 'enable_logging()'",
    "FROM arrow_scan(1, 2, 3)": "not 'arrow_scan()'",
    # Reading elsewhere.
    "FROM read_csv('/etc/passwd')": "not 'read_csv()'",
    "FROM read_text('/etc/hostname')": "not 'read_text()'",
    "FROM read_blob('STORE/sealed/*/spec.json')": "not 'read_blob()'",
    "FROM glob('/etc/*')": "not 'glob()'",
    "FROM '/etc/passwd'": "does not exist",
    "FROM 'STORE/sealed/*/spec.json'": "nothing else",
    "FROM read_parquet('STORE/sealed/*/truth.parquet')": "nothing else",
    "FROM read_parquet('STORE/samples/../sealed/*/truth.parquet')": "nothing else",
    "FROM parquet_schema('STORE/sealed/*/truth.parquet')": "nothing else",
    "FROM 'STORE/**/truth.parquet'": "nothing else",
    "FROM made": "does not exist",
    "SELECT getenv('HOME')": "does not exist",
    "FROM read_parquet('https://example.org/x.parquet')": "nothing else",
    "FROM 's3://bucket/x.parquet'": "nothing else",
    "FROM read_parquet(['STORE/samples/../../x.parquet'])": "nothing else",
    "FROM read_parquet('/proc/self/fd/0')": "nothing else",
    "SELECT * FROM runs, LATERAL (FROM read_text('/etc/hostname'))": "'read_text()'",
    "SELECT (SELECT content FROM read_text('/etc/hostname'))": "not 'read_text()'",
    "SELECT 1 WHERE EXISTS (FROM glob('STORE/sealed/*'))": "not 'glob()'",
    "WITH RECURSIVE f AS (FROM glob('/etc/*') UNION ALL FROM f) FROM f": "'glob()'",
    "FROM query_table('runs')": "not 'query_table()'",
    "FROM duckdb_secrets()": "not 'duckdb_secrets()'",
    "FROM which_secret('s3://a', 's3')": "not 'which_secret()'",
    "CREATE SECRET a (TYPE s3)": "got",
    "SET VARIABLE a = 1": "got",
    "FORCE INSTALL httpfs": "got LOAD",
    "LOAD '/tmp/evil.duckdb_extension'": "got LOAD",
    "SELECT 1 /* ; */ ; /* */ COPY runs TO 'x.csv'": "got 2 statements",
    "MERGE INTO catalogue.runs USING runs ON true WHEN MATCHED THEN DELETE": "got",
    "ALTER VIEW runs RENAME TO a": "got ALTER",
    "SELECT $a": "Values were not provided",
    "SELECT * FROM runs WHERE seed = 'x'": "Conversion Error",
}


@pytest.mark.parametrize("query", REFUSED)
def test_what_does_not_is_refused_in_one_line(opened, monkeypatch, query):
    store, folder = opened.path, str(opened.path).replace("'", "''")
    monkeypatch.chdir(store.parent)
    copying = f"WITH x AS (COPY (SELECT 1) TO '{folder}/samples/x.parquet') FROM x"
    answer = duckdb.execute("SELECT json_serialize_sql(?)", [copying])
    serialized = answer.fetchall()[0][0].replace("'", "'" * (4 if "query(" in query else 2))
    before = listing(store.parent)
    with pytest.raises(InputError) as refused:
        opened.sql(query.replace("STORE", folder).replace("SERIALISED", serialized))
    assert REFUSED[query] in str(refused.value)
    assert "\n" not in str(refused.value)
    assert listing(store.parent) == before
    assert opened.sql("FROM runs").num_rows == 3


def damage(path, how):
    data = path.read_bytes()
    if how == "torn":
        path.write_bytes(data[: len(data) // 2])
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "gone":
        path.unlink()
    else:
        # Also in the middle of a page, where DuckDB sees nothing by itself.
        samples.flip(path, int(how * len(data)))


@pytest.mark.parametrize(("how", "which"), [("torn", 2), ("empty", 0), ("gone", 0), (0.5, 0)])
def test_a_damaged_file_is_named_and_the_others_are_read(store, how, which):
    ids = [r["run_id"] for r in ask(store, "FROM runs")]
    id = sorted(ids)[which]
    path = find_run(store, id).folder / "part-0.parquet"
    damage(path, how)
    with pytest.raises(InputError, match="is damaged"):
        read_run(store, id)
    total = "sum(COLUMNS(* EXCLUDE (robot, run_id)))"
    query = f"SELECT run_id, {total} FROM samples GROUP BY run_id"
    with open_store(store) as opened:
        for _ in range(2):
            with pytest.raises(InputError, match=f"{id}.* is damaged"):
                opened.sql(query)
        rows = opened.sql(query, without_damaged=True)
        assert sorted(rows["run_id"].to_pylist()) == sorted(set(ids) - {id})
        assert opened.sql("FROM runs").num_rows == 3
        (line,) = opened.damaged
        assert str(path) in line
        assert "is damaged" in line


def test_a_damaged_row_is_named_and_the_others_are_listed(store):
    ids = [r["run_id"] for r in ask(store, "FROM runs")]
    shutil.rmtree(store / "_index")
    path = find_run(store, ids[1]).row
    damage(path, "torn")
    with open_store(store) as opened:
        for view in ("runs", "samples", "lineage"):
            with pytest.raises(InputError, match=rf"{ids[1]}.* is damaged"):
                opened.sql(f"FROM {view}")
        assert opened.sql("FROM adoptions").num_rows == 0
        rows = opened.sql("FROM runs", without_damaged=True)
        assert rows["run_id"].to_pylist() == [ids[0], ids[2]]
        assert opened.sql("FROM samples", without_damaged=True).num_rows == 100
        assert [str(path) in line for line in opened.damaged] == [True]


def test_a_path_in_a_text_blames_no_file(store):
    run = find_run(store, ask(store, "FROM runs")[0]["run_id"])
    path = run.folder / "part-0.parquet"
    told = str(path).replace("'", "''")
    with open_store(store) as opened:
        with pytest.raises(InputError, match="Conversion Error"):
            opened.sql(f"SELECT '{told}'::INTEGER")
        assert opened.damaged == ()


@pytest.mark.parametrize("how", ["deleted", "torn", "of another version"])
def test_the_index_is_written_again(store, how):
    before = ask(store, "FROM runs")
    path = store / "_index" / "runs.parquet"
    good = path.read_bytes()
    if how == "deleted":
        shutil.rmtree(path.parent)
    elif how == "torn":
        damage(path, "torn")
    else:
        pq.write_table(pq.read_table(path).drop_columns(["dirty"]), path)
    assert ask(store, "FROM runs") == before
    assert pq.read_table(path).num_rows == 3
    assert len(path.read_bytes()) == len(good)


def test_a_path_that_is_no_store_is_told(tmp_path):
    with pytest.raises(InputError, match="There is no store at"):
        open_store(tmp_path / "nothing")
    other = tmp_path / "other"
    other.mkdir()
    (other / ".gitkeep").touch()
    open_store(other).close()
    (other / "notes.txt").touch()
    with pytest.raises(InputError, match=r"is no store: expected .* got 'notes.txt'"):
        open_store(other)
    (tmp_path / "a*b").mkdir()
    with pytest.raises(InputError, match="must not contain"):
        open_store(tmp_path / "a*b")


def test_a_limit_of_time_leaves_no_thread_behind(opened, monkeypatch):
    # At the end of the program it would hold DuckDB: "nanobind: leaked 28 instances".
    timers, ended = [], threading.Event()

    class Slow(threading.Timer):
        def run(self):
            timers.append(self)
            super().run()
            ended.wait(0.2)  # as where the machine is busy

    monkeypatch.setattr(threading, "Timer", Slow)
    opened.sql("SELECT 1", timeout=60)
    assert [timer.is_alive() for timer in timers] == [False]
