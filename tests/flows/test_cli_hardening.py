"""What an attack on the store and its SQL found, item by item."""

import errno
import math
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from residual.errors import DEEPEST, InputError, check_nesting
from residual.model.model_files import load_model
from residual.robot.files import parse_toml
from tests.warehouse import store_samples as samples
from warehouse.sql_guard import LONGEST
from warehouse.store_catalogue import find_run
from warehouse.toml_records import LARGEST, read_toml

LONG = "SELECT count(*) FROM range(10000000) a, range(100000000) b WHERE a.range <> 7"


@pytest.fixture
def store(tmp_path):
    folder = tmp_path / "store"
    return folder, [samples.commit(folder, seed) for seed in range(2)]


@pytest.fixture
def run(store, tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MODELGAP_STORE", str(store[0]))
    return cli


@pytest.mark.parametrize("query", [LONG, "FROM range(1000000000000)"])
def test_a_query_is_stopped_after_its_time(run, query):
    code, out, err = run("sql", query, "--timeout", "0.2")
    assert (code, out) == (2, "")
    assert "stopped after 0.2 s" in err
    assert run("sql", "SELECT 1", "--timeout", "0")[0] == 2
    assert run("sql", "SELECT 1", "--timeout", "nan")[0] == 2
    assert run("sql", "SELECT 1", "--timeout", "inf")[0] == 0


def nested(depth):
    return "SELECT * FROM (" * depth + "SELECT 1 AS x" + ")" * depth


@pytest.mark.parametrize(
    "query",
    [
        nested(3000),
        "SELECT " + "(" * 5000 + "1" + ")" * 5000,
        "SELECT " + "+".join(["1"] * 20_000),
        "EXPLAIN " + nested(3000),
        "SELECT '" + "x" * LONGEST + "'",
    ],
    ids=["3000", "brackets", "sum", "explain", "long"],
)
def test_a_query_nested_too_deep_or_too_long_is_bad_input(run, query):
    code, _, err = run("sql", query)
    assert code == 2, err
    assert "Recursion" not in err
    assert len(err) < 1000
    assert run("sql", nested(20))[0] == 0  # as people do


@pytest.mark.parametrize("format", ["json", "parquet"])
def test_two_columns_of_one_name_are_refused_where_one_would_be_lost(run, format):
    query = "SELECT 1 AS x, 2 AS x"
    code, _, err = run("sql", query, "--format", format, "--out", "x")
    assert code == 2
    assert "Two columns have the name 'x'" in err
    assert not Path("x").exists()
    assert run("sql", query, "--format", "csv")[1].split() == ["x,x", "1,2"]


def test_nothing_is_written_among_the_records(run, store):
    folder, _ = store
    (folder / "_index").mkdir(exist_ok=True)
    before = sorted(folder.rglob("*"))
    for place in ("samples", "sealed", "_index"):
        out = str(folder / place / "x.tar")
        code, _, err = run("sql", "SELECT 1", "--out", out)
        assert (code, "among the records of the store" in err) == (2, True)
    assert sorted(folder.rglob("*")) == before
    assert run("sql", "SELECT 1", "--format", "csv", "--out", "x.csv")[0] == 0


def test_a_record_that_is_gone_is_told_by_runs_and_verify(run, store):
    folder, (id, other) = store
    assert run("runs")[2] == ""
    code, out, _ = run("verify")
    assert (code, "verified 2 runs" in out) == (0, True)
    find_run(folder, id).row.unlink()
    code, out, err = run("runs")
    assert code == 0
    assert id in err
    assert other not in err
    code, out, err = run("verify")
    assert code == 1
    assert f"DAMAGED  runs {id}: _run.parquet: it is missing" in out
    assert "modelgap: 1 of " in err


def test_files_nested_too_deep_are_bad_input(tmp_path):
    deep = tmp_path / "deep.toml"
    for depth in (DEEPEST + 2, 3000, 100_000):
        deep.write_text("a = " + "[" * depth + "]" * depth)
        with pytest.raises(InputError, match="nested too deep"):
            read_toml(deep)
        with pytest.raises(InputError, match="nested too deep"):
            parse_toml(deep.read_text(), "robot.toml")
        deep.write_text('{"a": ' + "[" * depth + "]" * depth + "}")
        with pytest.raises(InputError, match="nested too deep"):
            load_model(deep)
    deep.write_text("a = " + "[" * 20 + "]" * 20)
    assert check_nesting(read_toml(deep), "x")
    deep.write_text("#" * (LARGEST + 1))
    with pytest.raises(InputError, match="larger than"):
        read_toml(deep)


@pytest.fixture
def read_only(monkeypatch, store):
    """The store as on a read-only disk; root may write wherever bits forbid it."""
    real = Path.mkdir

    def refused(path, *args, **kwargs):
        if path.is_relative_to(store[0]) and not path.exists():
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
        return real(path, *args, **kwargs)

    monkeypatch.setattr(Path, "mkdir", refused)


def test_a_read_only_store_says_so_and_that_nothing_was_lost(run, store, read_only):
    assert run("runs")[0] == 0
    assert run("verify")[0] == 0
    with pytest.raises(InputError, match=r"read-only here.*Nothing was written"):
        samples.commit(store[0], 5)


def test_a_strangers_text_does_nothing_to_the_terminal(run, tmp_path):
    (tmp_path / "A.csv").write_text("t,\x1b[31mq1\x1b]0;x\x07\n1,2\n")
    code, _, err = run("check", "\x1b[31mA.csv", "--robot", "irb140")
    assert code == 2
    assert "\x1b" not in err
    assert "\\x1b[31mA.csv" in err
    code, _, err = run("check", "A.csv", "--robot", "irb140")
    assert code == 2
    assert "\x1b" not in err
    assert "\x07" not in err


TOO_LONG = "x" * 5000


@pytest.mark.parametrize(
    "words",
    [
        ("check", "{}", "--robot", "irb140"),
        ("check", "A.csv", "--robot", "{}"),
        ("experiment", "{}"),
        ("runs", "--store", "{}"),
        ("sql", "SELECT 1", "--out", "{}"),
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("name", ["loop.csv", TOO_LONG], ids=["loop", "long"])
def test_a_name_that_no_file_can_have_is_bad_input(run, tmp_path, words, name):
    (tmp_path / "A.csv").write_text("t,q1\n0,1\n")
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    code, _, err = run(*(word.format(name) for word in words))
    assert code == 2, err
    assert "unexpected" not in err
    assert len(err) < 1000


@pytest.mark.parametrize("step", [1e-12, 1e-300])
def test_a_time_in_steps_of_no_clock_is_bad_input(run, tmp_path, step):
    names = ["t", *(f"{c}{j}" for c in ("q", "tau") for j in range(1, 7))]
    angles = [[0.3 * math.sin(0.01 * i + j) for j in range(12)] for i in range(900)]
    rows = [[i * step, *values] for i, values in enumerate(angles)]
    lines = [",".join(names), *(",".join(map(repr, row)) for row in rows)]
    (tmp_path / "A.csv").write_text("\n".join(lines))
    for words in (("diagnose", "--trust-log"), ("import",)):
        code, _, err = run(*words, "A.csv", "--robot", "irb140")
        assert code == 2, err
        assert "is the unit of time right" in err
    code, out, _ = run("check", "A.csv", "--robot", "irb140")
    assert code == 0  # whatever it finds (docs/check.md)
    assert "samples per second, expected at most" in out


def test_a_parquet_file_of_more_rows_than_bytes_is_refused_at_once(run, tmp_path):
    names = ["t", *(f"{c}{j}" for c in ("q", "tau") for j in range(1, 7))]
    part = pa.table({name: np.zeros(2_000_000) for name in names})
    with pq.ParquetWriter(tmp_path / "A.parquet", part.schema) as file:
        for _ in range(2):
            file.write_table(part)
    code, _, err = run("check", "A.parquet", "--robot", "irb140")
    assert (code, "4000000 rows, expected several bytes" in err) == (2, True)


def test_an_escape_in_a_record_is_not_printed(run, store):
    id = samples.commit(store[0], 7, trajectory="\x1b[31mred")
    code, out, _ = run("runs")
    assert (code, id in out, "\x1b" in out) == (0, True, False)
    code, out, _ = run("show", id)
    assert (code, "\x1b" in out) == (0, False)
