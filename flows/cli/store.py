"""modelgap runs, show, sql, verify, quarantine, diff, lineage, rerun: the records of a store."""

import json
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from flows.cli import STDOUT
from flows.outputs import (
    check_outside,
    check_writable,
    print_damaged_files,
    print_plain,
    write_files,
)
from flows.requests import (
    File,
    Flag,
    Format,
    Json,
    Name,
    Number,
    RecordId,
    Seconds,
    Store,
    TableFormat,
    Tags,
    Text,
    TextFormat,
)
from flows.settings import resolve_store_folder
from residual.errors import InputError, RunError, check_name

if TYPE_CHECKING:
    import pyarrow as pa


_COLUMNS = "run_id, robot, log, tags, kind, trajectory, duration_s, created, quarantined"


def runs(*, limit: Number = 50, format: Format = "table", store: Store = None) -> None:
    """List the runs of the store, the latest last.

    ```
    modelgap runs
    modelgap runs --limit 1000 --format csv
    ```

    Args:
        limit: Number of runs.
    """
    from flows.report.records import print_query_result, refuse_binary_on_terminal
    from warehouse.queries import open_store
    from warehouse.store_catalogue import read_manifest

    if limit < 1:
        raise InputError(f"--limit {limit}: expected 1 or more.")
    refuse_binary_on_terminal(format, None)
    with open_store(resolve_store_folder(store)) as opened:
        latest = f"FROM runs ORDER BY created DESC, run_id LIMIT {limit}"
        query = f"SELECT {_COLUMNS} FROM ({latest}) ORDER BY created, run_id"
        rows = opened.sql(query, without_damaged=True)
        print_query_result(rows, format)
        print_damaged_files(opened.damaged)
        for id in rows.column("run_id").to_pylist():
            try:
                read_manifest(opened.path, id)
            except InputError as error:
                print(f"modelgap: listed from a copy: {error}", file=sys.stderr)


def verify(*, store: Store = None) -> None:
    """Check every byte of the store.

    ```
    modelgap verify
    ```

    Compares every file of every record, seal and robot with its SHA-256, and every id
    with the hash of its content. Exit code 1 if something is damaged or missing.
    Changes nothing, and takes about as long as reading the store from the disk.
    """
    from flows.steps import rerun as steps

    for line in steps.find_damaged_files(resolve_store_folder(store)):
        print(line, flush=True)


def quarantine(id: str, /, *, reason: Text, store: Store = None) -> None:
    """Mark a run as unusable.

    ```
    modelgap quarantine 3f2a --reason "the gripper was loose"
    ```

    The run itself is not changed. In SQL it has quarantined = true, monitor refuses it,
    and the inbox ignores it; its id still reads it. To undo, delete the file
    quarantine/run_id=ID.json of the store.

    Args:
        id: Id of the run, or its beginning.
        reason: Reason, stored with the run; the first one is kept.
    """
    from warehouse.queries import open_store
    from warehouse.store_catalogue import find_record, read_quarantine_reason
    from warehouse.store_catalogue import quarantine_run as set_aside

    with open_store(resolve_store_folder(store)) as opened:
        run_id = find_record(opened.path, id).id
        reason_before = read_quarantine_reason(opened.path, run_id)
        set_aside(opened.path, run_id, reason)
    text = (
        f"already in quarantine: {reason_before}" if reason_before else f"in quarantine: {reason}"
    )
    print(f"{run_id} {text}")


_RELATIVES = {
    "parents": "SELECT parent, role FROM lineage WHERE child = $id",
    "children": "SELECT child, role FROM lineage WHERE parent = $id",
}


def show(id: RecordId, /, *, format: TextFormat = "text", store: Store = None) -> None:
    """Show one run, model, diagnosis, validation or report.

    ```
    modelgap show 3f2a
    modelgap show 3f2a --format json
    ```

    For a diagnosis: verdict, findings, errors, sources, and whether its model is
    adopted; json has the full record.
    """
    from warehouse.queries import open_store
    from warehouse.store_catalogue import find_record, read_quarantine_reason, read_record

    with open_store(resolve_store_folder(store)) as opened:
        place = find_record(opened.path, id)
        record = {
            "kind": place.kind,
            "id": place.id,
            "folder": str(place.folder.relative_to(opened.path)),
            **{
                name: opened.sql(query, {"id": place.id}, without_damaged=True).to_pylist()
                for name, query in _RELATIVES.items()
            },
            "quarantined": read_quarantine_reason(opened.path, place.id),
            "content": read_record(opened.path, place.id),
        }
        print_damaged_files(opened.damaged)
    if format == "json":
        print(json.dumps(record, indent=2, ensure_ascii=False))
    elif place.kind == "diagnoses":
        _summarize_diagnosis(record, opened.path)
    else:
        from flows.report.records import format_record_lines

        print("\n".join(format_record_lines(record)))


def _summarize_diagnosis(record: Mapping, store: Path) -> None:
    from flows.report import print_parts, widen_piped_console
    from flows.report.diagnosis import describe_parents, print_diagnosis
    from residual.verdict.document import parse_verdict
    from residual.verdict.result import Diagnosis
    from warehouse.store_catalogue import describe_diagnosis_adoption

    id, content = record["id"], record["content"]
    try:
        verdict = parse_verdict(content.get("document"))
    except InputError as error:
        raise InputError(f"{error} See the record with --format json.") from error
    console = widen_piped_console(Console(), 1000)
    print_plain(console, f"diagnosis {id} of {verdict.robot}")
    adoption = describe_diagnosis_adoption(store, id)
    print_diagnosis(Diagnosis(verdict), console)
    print_parts(console, *describe_parents(record["parents"]), adoption)
    if record["quarantined"]:
        print_plain(console, f"in quarantine: {record['quarantined']}")
    print_plain(console, f"full record: modelgap show {id[:8]} --format json")


_ONE_OF = 'Give one of: a query in quotes ("SELECT ..."), --named NAME, --schema.'


def sql(
    query: str | None = None,
    /,
    *,
    named: Name = None,
    with_: Annotated[Tags, Parameter(name="--with", metavar="KEY=VALUE")] = (),
    schema: Flag = False,
    format: Annotated[
        Format, Parameter(help="Format of the answer; parquet needs --out on a terminal.")
    ] = "table",
    out: File = None,
    json: Json = None,
    timeout: Seconds = 60.0,
    without_damaged: Flag = False,
    truth: Flag = False,
    store: Store = None,
) -> None:
    """Query the store in SQL.

    ```
    modelgap sql "SELECT robot, count(*) FROM runs GROUP BY robot"
    modelgap sql --schema
    modelgap sql --named error_by_trajectory --format csv
    modelgap sql --named runs_of_model --with model=3f2a
    modelgap sql "FROM samples WHERE run_id = '...'" --format parquet --out run.parquet
    ```

    The store is opened for reading only. Without an argument, one query is read from
    standard input. A query may use half of this machine's memory, its answer a quarter.
    Damaged samples are an error that names the run. JSON holds numbers that are not
    finite as the texts NaN, Infinity and -Infinity.

    Args:
        query: One SELECT over the views, in the SQL of DuckDB.
        named: Name of a named query (--schema lists them).
        with_: Value of a named query, as name=value; may be repeated.
        schema: Show the views with the unit of every column, and the named queries.
        out: File for the answer, not among the records of the store.
        timeout: Longest time of the query, in seconds; inf for no limit.
        without_damaged: Leave damaged records out, and list them.
        truth: Open the seals of all simulated runs, and mark these as opened: this
            query has the view truth (docs/sql.md).
    """
    from flows.report.records import (
        list_named_queries,
        list_schema_columns,
        print_query_result,
        refuse_binary_on_terminal,
    )
    from warehouse.queries import open_store
    from warehouse.sql_guard import limit_process_memory

    place = resolve_store_folder(store)
    if json is not None:
        if out or format != "table":
            raise InputError("--json sets format and file: omit --format and --out.")
        format, out = "json", json if json != STDOUT else None
    choices = [query is not None, named is not None, schema]
    if sum(choices) > 1 or (sys.stdin.isatty() and not any(choices)):
        raise InputError(_ONE_OF)
    if truth and query is None and (named or schema):
        raise InputError("--truth needs a query as text: no named query reads truth.")
    if with_ and named is None:
        raise InputError("--with sets a value of a named query: give --named NAME.")
    refuse_binary_on_terminal(format, out)
    check_writable({"--out": Path(out)} if out else {}, ())
    check_outside(out, place)
    if not timeout > 0:
        raise InputError(f"--timeout {timeout}: expected seconds above 0, or inf.")
    limit = timeout if timeout <= threading.TIMEOUT_MAX else None
    if schema:
        _write(list_schema_columns(), format, out)
        if out is None and format == "table":
            print()
            print_query_result(list_named_queries(), "table")
        return
    text, values = _query(query, named, with_)
    with limit_process_memory(), open_store(place) as opened:
        if truth:
            from flows.sealed_truth import show_truth

            show_truth(opened)
        rows = opened.sql(text, values, without_damaged=without_damaged, timeout=limit)
        _write(rows, format, out)
        print_damaged_files(opened.damaged)


def _query(
    query: str | None, named: str | None, pairs: Sequence[str]
) -> tuple[str, Mapping[str, str]]:
    from flows.report.records import describe_query_values
    from warehouse.sql_guard import LONGEST, NAMED

    if named is None:
        query = query if query is not None else sys.stdin.read(LONGEST + 1)
        if not query.strip():
            raise InputError(_ONE_OF)
        return query, {}
    name = check_name(named, NAMED, "named query")
    values = {key: value for key, _, value in (pair.partition("=") for pair in pairs)}
    takes = describe_query_values(name)
    if set(values) != set(takes) or len(values) < len(pairs) or "" in values.values():
        words = " ".join(f"--with {key}=... ({about})" for key, about in takes.items())
        raise InputError(
            f"'{name}' takes {words or 'no --with'}, got {', '.join(pairs) or 'none'}."
        )
    return NAMED[name][1], values


def _write(rows: "pa.Table", format: str, out: str | None) -> None:
    from flows.report.records import encode_query_result, print_query_result

    if out is None:
        print_query_result(rows, format)
        return
    write_files({Path(out): encode_query_result(rows, format)})
    print(f"wrote {out}: {len(rows)} {'row' if len(rows) == 1 else 'rows'}")


def diff(one: str, two: str, /, *, format: TableFormat = "table", store: Store = None) -> None:
    """Compare two runs, models, diagnoses or validations.

    ```
    modelgap diff 3f2a 77c0
    modelgap diff 3f2a 77c0 --format json
    ```

    Compares spec, code, environment and values; of runs each channel, with the time
    and the size of the difference.

    Args:
        one: Id of a record, or its beginning.
        two: Id of a second record of the same kind.
    """
    from flows.report import print_parts, widen_piped_console
    from flows.report.records import build_diff_record, build_diff_tables
    from flows.steps import rerun as steps

    difference = steps.diff_records(one, two, resolve_store_folder(store))
    if format == "json":
        print(json.dumps(build_diff_record(difference), indent=2, ensure_ascii=False))
    else:
        print_parts(widen_piped_console(Console(), 1000), *build_diff_tables(difference))


def lineage(
    id: RecordId,
    /,
    *,
    up: Flag = False,
    down: Flag = False,
    format: TableFormat = "table",
    store: Store = None,
) -> None:
    """Show the sources of a record, and the records made from it.

    ```
    modelgap lineage 3f2a
    modelgap lineage 3f2a --down
    ```

    Args:
        up: Only the sources.
        down: Only the records made from it.
    """
    from flows.report import widen_piped_console
    from flows.report.records import print_tree
    from warehouse.queries import build_lineage_tree, open_store

    directions = {"made from": up or not down, "gave": down or not up}
    with open_store(resolve_store_folder(store)) as opened:
        trees = {
            words: build_lineage_tree(opened, id, words == "gave")
            for words, shown in directions.items()
            if shown
        }
    if format == "json":
        document = {words: asdict(root) for words, root in trees.items()}
        print(json.dumps(document, indent=2))
        return
    for words, root in trees.items():
        print_tree(root, words, widen_piped_console(Console(), 1000))


def rerun(
    id: RecordId, /, *, verify: Flag = False, format: TextFormat = "text", store: Store = None
) -> None:
    """Repeat a run, model, diagnosis or validation, and compare bit for bit.

    ```
    modelgap rerun 3f2a --verify
    modelgap rerun 3f2a
    ```

    A simulated run is repeated from its spec and its sealed half, another record from
    its request and its sources. For values that differ it prints which, from when, by
    how much, and the likely cause: code, environment, machine, seed or spec, or damage
    (docs/reproducibility.md).

    With the same code nothing is stored; with other code the new record is stored, with
    the first one as its parent. Differences are stored: modelgap sql --named
    reruns_not_reproduced.

    Exit code 1: with --verify, a value differs; without it, a value differs although
    the code is the same.

    Args:
        verify: Only compare, store nothing. A measured run is checked against the hash
            of its values.
    """
    from flows.report.records import build_rerun_record, describe_rerun
    from flows.steps import rerun as reruns

    place = resolve_store_folder(store)
    outcome = reruns.rerun(id, place, verify)
    if format == "json":
        print(json.dumps(build_rerun_record(outcome), indent=2, ensure_ascii=False))
    else:
        print("\n".join(describe_rerun(outcome)))
    if not outcome.reproduced and (verify or outcome.same_code):
        raise RunError(f"{outcome.kind} {outcome.id} was not reproduced.")
