"""What modelgap sql does; apart, since it loads the database."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from flows.cli.store_work import tell_damage
from flows.outputs import check_writable, write_all
from flows.report.terminal.answers import as_bytes, check_shown, print_table
from flows.settings import store_folder
from residual.errors import InputError
from residual.names import check_name
from warehouse.query.named import NAMED, TAKES
from warehouse.query.store import Store, open_store
from warehouse.schema import all_views

with suppress(ImportError):
    import readline  # noqa: F401  gives the prompt its arrow keys

LIST = "list"
FIRST, NEXT = "modelgap> ", "     ...> "
HELP = (
    "A query ends with ; or an empty line. Ctrl-D ends. Views: modelgap sql --schema."
)


@dataclass(frozen=True, slots=True)
class Question:
    """What was asked.

    Attributes:
        query: SQL, None for none.
        named: Name of a query, "list" for which there are, None for none.
        values: Values for it, as name=value.
        schema: Whether to show the views.
        format: "table", "csv", "json" or "parquet".
        out: File for the answer, None for standard output.
    """

    query: str | None = None
    named: str | None = None
    values: tuple[str, ...] = ()
    schema: bool = False
    format: str = "table"
    out: str | None = None


def answer(question: Question, option: str | None) -> None:
    """Print or write the answer; on a terminal and without a query, open a prompt.

    Args:
        question: What was asked.
        option: Folder of the store, as the user said.

    Raises:
        InputError: If the question is not usable or its answer fails.
    """
    asked = [question.query is not None, question.named is not None, question.schema]
    if sum(asked) > 1:
        raise InputError(
            'Give one of: a query in quotes ("SELECT ..."), --named NAME, --schema.'
        )
    if question.values and question.named in (None, LIST):
        raise InputError("--with gives a value to a query of --named NAME.")
    check_shown(question.format, question.out)
    if question.out is not None:
        check_writable({"--out": Path(question.out)}, ())
    if question.schema:
        _give(schema_table(), question)
    elif question.named == LIST:
        _give(named_table(), question)
    elif not any(asked) and sys.stdin.isatty():
        with open_store(store_folder(option)) as store:
            prompt(store, question.format)
    else:
        query, values = _query(question)
        with open_store(store_folder(option)) as store:
            _give(store.sql(query, values), question)
            tell_damage(store)


def prompt(store: Store, format: str) -> None:
    """Read queries and print answers until the end; an error ends only its query.

    Args:
        store: The opened store.
        format: How to print answers.
    """
    print(HELP)
    for query in _typed():
        try:
            print_table(store.sql(query), format)
            tell_damage(store)
        except InputError as error:
            print(error)
        except KeyboardInterrupt:
            print("cancelled")


def _typed() -> Iterator[str]:
    lines: list[str] = []
    while True:
        try:
            line = input(NEXT if lines else FIRST).strip()
        except KeyboardInterrupt:
            print()
            lines.clear()
            continue
        except EOFError:
            print()
            return
        lines.append(line)
        if not line or line.endswith(";"):
            query = "\n".join(lines).strip()
            lines.clear()
            if query:
                yield query


def schema_table() -> pa.Table:
    """Return every view and column with type, unit and meaning."""
    rows = [
        {
            "view": view,
            "column": column.name,
            "type": str(column.type),
            "unit": column.unit or "none",
            "about": column.about,
        }
        for view, columns in all_views().items()
        for column in columns
    ]
    return pa.Table.from_pylist(rows)


def named_table() -> pa.Table:
    """Return the named queries with a sentence each, and what they need."""
    rows = [
        {
            "--named": name,
            "answers": about,
            "--with": ", ".join(f"{k}=... ({v})" for k, v in _takes(name).items()),
        }
        for name, (about, _) in NAMED.items()
    ]
    return pa.Table.from_pylist(rows)


def _query(question: Question) -> tuple[str, Mapping[str, str]]:
    if question.named is None:
        query = question.query if question.query is not None else sys.stdin.read()
        if not query.strip():
            raise InputError(
                'Give one of: a query in quotes ("SELECT ..."), --named NAME, --schema.'
            )
        return query, {}
    name = check_name(question.named, NAMED, "named query")
    return NAMED[name][1], _values(name, question.values)


def _values(name: str, given: Sequence[str]) -> dict[str, str]:
    pairs = [word.partition("=") for word in given]
    values = {key: value for key, _, value in pairs}
    wanted = _takes(name)
    if set(values) != set(wanted) or len(values) < len(given) or "" in values.values():
        told = " ".join(f"--with {key}=... ({about})" for key, about in wanted.items())
        raise InputError(
            f"'{name}' takes {told or 'no --with'}, got {', '.join(given) or 'none'}."
        )
    return values


def _takes(name: str) -> Mapping[str, str]:
    return TAKES.get(name, {})


def _give(rows: pa.Table, question: Question) -> None:
    if question.out is not None:
        write_all({Path(question.out): as_bytes(rows, question.format)})
        noun = "row" if len(rows) == 1 else "rows"
        print(f"wrote {question.out}: {len(rows)} {noun}")
        return
    print_table(rows, question.format)
    if question.schema and question.format == "table":
        print()
        print_table(named_table(), "table")
