"""The table of hostile inputs: valid files, and what is done to them."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from benchmarks.hardening_parts import http, strangers
from benchmarks.hardening_parts.strangers import Input
from benchmarks.store_parts.made import records, run
from residual.robot.robot import load_robot
from sim.engine.records import TrajectorySpec
from sim.trajectories import make_reference

SEEDS = 12  # random edits of each file


def prepare(place: Path) -> dict[str, Path]:
    robot = load_robot("irb140")
    motion = make_reference(robot, TrajectorySpec("cyclic", 4.0, 1, 0), 100.0)
    rng = np.random.default_rng(3)
    tau = 10 * motion.q + rng.normal(size=motion.q.shape)
    names = ["t", *(f"{c}{j}" for c in ("q", "tau") for j in range(1, 7))]
    log = place / "log.csv"
    table = np.column_stack([motion.t, motion.q, tau])
    np.savetxt(log, table, "%.9g", ",", header=",".join(names), comments="")
    origin = place / "origin"
    records(origin, [run(origin, seed) for seed in range(2)])
    (place / "map.toml").write_text(_MAP)
    (place / "spec.toml").write_text(_SPEC)
    (place / "arm.urdf").write_text(robot.urdf)
    return {path.stem: path for path in place.iterdir()}


_MAP = """time = {column = "t", unit = "s"}
q = {columns = ["q1", "q2", "q3", "q4", "q5", "q6"], unit = "rad", side = "link"}
tau = {columns = ["tau1", "tau2", "tau3", "tau4", "tau5", "tau6"], unit = "N m"}
csv = {separator = ",", decimal = "."}
"""
_SPEC = """schema = 1
robot = "irb140"
seed = 7
[trajectory]
kind = "cyclic"
duration = 4.0
"""


def _edits(good: bytes) -> Iterator[tuple[str, bytes, bool]]:
    """Give what is done to any text: its name, the text, whether none may take it."""
    yield "empty", b"", True
    yield "blank", b" \n\t\n" * 50, True
    yield "zeros", bytes(4096), True
    yield "noise", np.random.default_rng(0).bytes(20_000), True
    yield "UTF-16", good.decode().encode("utf-16"), True
    yield "not UTF-8", good.replace(b"q", b"\xff\xfe", 1), False
    yield "zero inside", good[: len(good) // 2] + b"\0" + good[len(good) // 2 :], False
    yield "half", good[: len(good) // 2], False
    yield "twice", good + good, False
    yield "escape", good.replace(b"t", b"\x1b[31m", 1), False
    yield "lines of CR", good.replace(b"\n", b"\r"), False
    yield "long line", b"x" * 200_000 + b"\n" + good, False
    yield "brackets", b"[" * 100_000, True
    yield "deep", b"a = " + b"[" * 3000 + b"]" * 3000, True
    rng = np.random.default_rng(len(good))
    words = (b"nan", b"1e999", b"-1", b"", b"'", b'"', "∞".encode(), b"9" * 400, b"{")
    for seed in range(SEEDS):
        data = bytearray(good)
        at = int(rng.integers(len(data)))
        if seed % 2:
            data[at] ^= 1 << int(rng.integers(8))
            yield f"bit {seed}", bytes(data), False
        else:
            data[at : at + int(rng.integers(1, 9))] = words[seed // 2 % len(words)]
            yield f"word {seed}", bytes(data), False


def _of_text(kind: str, file: str, words: tuple[str, ...]) -> Callable:
    """Return what makes the inputs of one kind from its valid file."""

    def made(base: Mapping[str, Path]) -> list[Input]:
        good = base[Path(file).stem].read_bytes()
        paths = {"LOG": str(base["log"])}
        given = tuple(paths.get(word, word) for word in words)
        judge = "samples" if kind == "log" else None
        # Nothing is a whole TOML file, of which every key has its default.
        whole = ("empty", "blank") if file.endswith(".toml") else ()
        values = _VALUES[kind](good.decode())
        every = [
            (name, data, none and name not in whole, judge)
            for name, data, none in _edits(good)
        ]
        # Of what a value means only its reader can say; none may be taken for another.
        every += [(*edit, None) for edit in values]
        return [
            Input(kind, name, given, file, data, "refuse" if none else other)
            for name, data, none, other in every
        ]

    return made


_VALUES: Mapping[str, Callable] = {
    "log": http.bad_logs,
    "robot": http.bad_robots,
    "map": lambda good: http.bad_maps(),
    "spec": lambda good: http.bad_specs(),
}


def _of_http(base: Mapping[str, Path]) -> list[Input]:
    return [
        Input("http", name, (), judge="answer" if own else "refuse", request=asked)
        for name, asked, own in (*http.requests(), *strangers.requests())
    ]


def _of_sql(base: Mapping[str, Path]) -> list[Input]:
    made = [("subqueries 100", _nested(100), "answer", '"x": 1')]
    for depth in (500, 2000, 5000):
        made.append((f"subqueries {depth}", _nested(depth), "refuse", None))
    made += [(word[:30], word, "refuse", None) for word in _FORBIDDEN]
    made += [(query[:30], query, "answer", said) for query, said in _ANSWERED.items()]
    tail = ("--format", "json", "--timeout", "5", "--store", str(base["origin"]))
    return [
        Input("sql", name, ("sql", query, *tail), judge=judge, answer=answer)
        for name, query, judge, answer in made
    ]


def _nested(depth: int) -> str:
    return "SELECT * FROM (" * depth + "SELECT 1 AS x" + ")" * depth


_FORBIDDEN = (
    *("", ";", "SELECT 1; SELECT 2", "SELECT", "SELECT '", "SELECT \0"),
    *("DROP TABLE runs", "DELETE FROM runs", "INSERT INTO runs VALUES (1)"),
    *("CREATE TABLE x AS SELECT 1", "COPY runs TO 'x.csv'", "ATTACH 'x.db'"),
    "WITH x AS (COPY (SELECT 1) TO 'x.csv') FROM x",
    "EXPLAIN ANALYZE COPY (SELECT 1) TO 'x.csv'",
    *("INSTALL httpfs", "LOAD httpfs", "SET memory_limit = '1TB'", "VACUUM"),
    *("SET lock_configuration = false", "PRAGMA database_list", "CHECKPOINT"),
    *("CALL enable_logging()", "CALL truncate_duckdb_logs()", "EXPORT DATABASE 'x'"),
    *("FROM read_csv('/etc/passwd')", "FROM read_text('/etc/passwd')"),
    *("FROM '/etc/passwd'", "FROM read_blob('sealed/*')", "FROM glob('/*')"),
    *("FROM read_parquet('http://127.0.0.1:1/x.parquet')", "FROM query('SELECT 1')"),
    *("FROM query_table('runs')", "FROM json_execute_serialized_sql('{}')"),
    *("FROM sqlite_scan('x', 'y')", "FROM duckdb_secrets()"),
    "SELECT getenv('HOME') FROM nothing",
    "SELECT count(*) FROM range(100000000) a, range(100000000) b WHERE a <> b",
    *("SELECT list(i) FROM range(100000000000) t(i)", "FROM range(1000000000000)"),
    "WITH RECURSIVE t(i) AS (SELECT 1 UNION ALL SELECT i FROM t) SELECT sum(i) FROM t",
    *("SELECT repeat('x', 100000000000)", "SELECT 1 AS x, 2 AS x"),
    *("SELECT '" + "x" * 200_000 + "'", "SELECT " + "(" * 4000 + "1" + ")" * 4000),
    *("SELECT " + "+".join(["1"] * 20_000), "SELECT " + "-" * 5000 + "1"),
    *("SELECT " + "NOT " * 5000 + "true", "SELECT 'x'::INTEGER"),
    "SELECT made_up FROM runs",
    "SELECT regexp_matches(repeat('a', 100), '(') AS x",
)
_ANSWERED = {
    "SELECT 'inf'::DOUBLE AS x": '"Infinity"',
    "SELECT 'nan'::DOUBLE AS x": '"NaN"',
    f"SELECT {2**127 - 1} AS x": str(2**127 - 1),
    "SELECT 0.12345678901234567890123456789 AS x": "0.12345678901234567890123456789",
    "SELECT NULL AS x": "null",
    "SELECT count(*) AS x FROM runs": '"x": 2',
    "SELECT count(*) AS x FROM samples": '"x": 100',
    "SELECT chr(27) AS x": "\\u001b",
}

_WORDS = {
    "log": ("log.csv", "import log.csv --robot irb140 --trust-log"),
    "robot": ("arm.urdf", "check LOG --robot arm.urdf"),
    "map": ("map.toml", "check LOG --robot irb140 --map map.toml"),
    "spec": ("spec.toml", "experiment spec.toml --dry-run"),
}
TABLE = {
    **{k: _of_text(k, file, tuple(w.split())) for k, (file, w) in _WORDS.items()},
    "sql": _of_sql,
    "name": strangers.of_names,
    "inbox": strangers.of_inboxes,
    "table": strangers.of_tables,
    "http": _of_http,
}
