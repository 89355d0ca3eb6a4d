"""Readers of logs: text, Parquet, bags of ROS and MCAP."""

import io
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import strategies as st

from tests.fuzz.arm import arm, as_csv, check_rows, samples, table_of
from tests.fuzz.mutation import Draw, flipped, mutated
from tests.fuzz.reader import Reader
from tests.warehouse import log_files as files
from tests.warehouse.conftest import NAMES
from warehouse.logs import ColumnMap, read_log

_HEAD = "Recorded by a viewer\nController;7\n\n"
_CSV_WORDS = tuple(word.encode() for word in (*NAMES, "q3", "q0", "qd1", "[deg]", "NA"))


def _read_csv(data: bytes, place: Path) -> None:
    file = place / "log.csv"
    file.write_bytes(data)
    log, understood = read_log(str(file), arm(), despite_doubts=True)
    table = table_of(data)
    if table is not None:
        check_rows(log, understood, table)


def _csv_seeds() -> list[bytes]:
    plain, semicolons = as_csv(), as_csv(";")
    units = as_csv().replace("\n", "\n[s],[rad],[rad],[Nm],[Nm]\n", 1)
    texts = plain, semicolons, units, _HEAD + semicolons, as_csv("\t")
    return [text.encode() for text in texts]


def _read_parquet(data: bytes, place: Path) -> None:
    file = place / "log.parquet"
    file.write_bytes(data)
    log, understood = read_log(str(file), arm(), despite_doubts=True)
    table = pq.ParquetFile(file).read()
    columns = {name: table.column(name).to_pylist() for name in NAMES}
    plain = {n: [np.nan if x is None else x for x in c] for n, c in columns.items()}
    check_rows(log, understood, plain)


@cache
def _parquet_seeds() -> list[bytes]:
    table = pa.table(dict(zip(NAMES, samples().T.copy(), strict=True)))
    return [
        _parquet(table, compression="none"),
        _parquet(table, compression="snappy"),
        _parquet(table, use_dictionary=False, compression="none"),
    ]


def _parquet(table: pa.Table, **how: Any) -> bytes:
    file = io.BytesIO()
    pq.write_table(table, file, **how)
    return file.getvalue()


_KINDS = (
    *(pa.float64(), pa.float32(), pa.float16(), pa.int64(), pa.int8(), pa.uint64()),
    *(pa.string(), pa.bool_(), pa.decimal128(20, 4), pa.list_(pa.float64()), pa.null()),
    *(pa.timestamp("us"), pa.duration("ns"), pa.dictionary(pa.int8(), pa.float64())),
    *(pa.binary(), pa.time64("us"), pa.date32(), pa.struct([("x", pa.float64())])),
    *(pa.map_(pa.string(), pa.float64()), pa.large_string()),
)


@st.composite
def _odd_tables(draw: Draw) -> bytes:
    names = list(NAMES)
    columns = [pa.array(column) for column in samples().T.copy()]
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(names) - 1))
        kind = draw(st.sampled_from(("kind", "value", "name", "more", "gone")))
        if kind == "kind":
            columns[at] = _cast(columns[at], draw(st.sampled_from(_KINDS)))
        elif kind == "value" and columns[at].type == pa.float64():
            values = columns[at].to_pylist()
            odd = st.sampled_from((None, np.nan, np.inf, 1e308, -1e308, 0.0))
            values[draw(st.integers(0, len(values) - 1))] = draw(odd)
            columns[at] = pa.array(values, pa.float64())
        elif kind == "name":
            names[at] = draw(st.sampled_from((*NAMES, "q3", "tau9", "", "x", "qd1", "é")))
        elif kind == "more":
            names.append(draw(st.sampled_from((*NAMES, "qd1", "qd2", "q3", ""))))
            columns.append(columns[at])
        elif kind == "gone" and len(names) > 1:
            del names[at], columns[at]
    rows = draw(st.sampled_from((30, 30, 30, 2, 1, 0)))
    return _parquet(pa.Table.from_arrays(columns, names=names).slice(0, rows))


def _cast(column: pa.Array, kind: pa.DataType) -> pa.Array:
    try:
        return column.cast(kind, safe=False)
    except (pa.ArrowException, ValueError):
        return pa.nulls(len(column), kind)


def _read_bag(data: bytes, place: Path) -> None:
    name = "log.db3" if data.startswith(b"SQLite") else "log.bag"
    (place / name).write_bytes(data)
    log, understood = read_log(str(place / name), arm(), ColumnMap(), despite_doubts=True)
    assert len(log.t) == understood.rows


@cache
def _bag_seeds() -> list[bytes]:
    with tempfile.TemporaryDirectory() as place:
        topics = {"/js": list(files.messages(samples()))}
        one = files.write_bag(Path(place) / "log.bag", topics, 1)
        files.write_bag(Path(place) / "two", topics, 2)
        two = next(p for p in (Path(place) / "two").iterdir() if p.suffix == ".db3")
        return [Path(one).read_bytes(), two.read_bytes()]


def _read_mcap(data: bytes, place: Path) -> None:
    file = place / "log.mcap"
    file.write_bytes(data)
    log, understood = read_log(str(file), arm(), despite_doubts=True)
    assert len(log.t) == understood.rows


@cache
def _mcap_seeds() -> list[bytes]:
    with tempfile.TemporaryDirectory() as place:
        path = files.write_mcap(Path(place) / "log.mcap", {"/js": list(files.messages(samples()))})
        return [Path(path).read_bytes()]


LOGS = (
    Reader("csv", lambda: mutated(_csv_seeds(), _CSV_WORDS), _csv_seeds, _read_csv),
    Reader(
        "parquet",
        lambda: st.one_of(_odd_tables(), flipped(_parquet_seeds())),
        _parquet_seeds,
        _read_parquet,
    ),
    Reader("bag", lambda: flipped(_bag_seeds()), _bag_seeds, _read_bag),
    Reader("mcap", lambda: flipped(_mcap_seeds()), _mcap_seeds, _read_mcap),
)
