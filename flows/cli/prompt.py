"""The prompt of modelgap sql: queries one after the other, with completion."""

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from flows.cli.store_work import tell_damage
from flows.report.terminal.answers import print_table
from residual.errors import InputError
from warehouse.query.named import NAMED, TAKES
from warehouse.query.store import Store
from warehouse.schema import all_views

HISTORY, KEPT = "_sql_history", 2000
FIRST, NEXT = "modelgap> ", "     ...> "
_SQL = (
    "SELECT FROM WHERE GROUP BY ORDER LIMIT JOIN LEFT USING ON AS AND OR NOT IN IS "
    "NULL DISTINCT COUNT AVG MIN MAX SUM ROUND FILTER HAVING WITH UNION ALL CASE WHEN "
    "THEN ELSE END ILIKE BETWEEN DESC ASOF DESCRIBE SUMMARIZE EXPLAIN OVER PARTITION"
)
HELP = (
    "A query ends with ; or an empty line. Tab completes. \\schema shows views and "
    "columns, \\named the named queries, \\named NAME asks one. Ctrl-D ends."
)


def prompt(store: Store, format: str) -> None:
    """Read queries and print answers until the end; an error ends only its query.

    Args:
        store: The opened store.
        format: How to print answers.
    """
    with suppress(ImportError):
        _prepare(store.path / HISTORY)
    print(HELP)
    lines: list[str] = []
    while True:
        try:
            line = input(NEXT if lines else FIRST)
        except KeyboardInterrupt:
            print()
            lines.clear()
            continue
        except EOFError:
            print()
            return
        lines.append(line)
        query = "\n".join(lines).strip()
        if not query or not _is_whole(lines):
            lines = lines if query else []
            continue
        lines.clear()
        if query.rstrip(";").strip() in ("quit", "exit", "\\q"):
            return
        try:
            _answer(store, query, format)
        except InputError as error:
            print(error)
        except KeyboardInterrupt:
            print("cancelled")


def complete(text: str, state: int) -> str | None:
    """Return the next word that begins with a text, as readline asks for it.

    Args:
        text: What was typed of the word.
        state: How many were given before.
    """
    found = completions(text)
    return found[state] if state < len(found) else None


def completions(text: str) -> list[str]:
    """Return all words that begin with a text: views, columns, SQL.

    Args:
        text: What was typed of the word, behind "view." too.
    """
    views = all_views()
    view, dot, rest = text.rpartition(".")
    if dot and view in views:
        return [f"{view}.{c.name}" for c in views[view] if c.name.startswith(rest)]
    columns = (c.name for columns in views.values() for c in columns)
    sql = [
        word if text.isupper() or not text else word.lower() for word in _SQL.split()
    ]
    words = ["\\schema", "\\named", *views, *columns, *sql, *NAMED]
    return [w for w in dict.fromkeys(words) if w.lower().startswith(text.lower())]


def _is_whole(lines: Sequence[str]) -> bool:
    last = lines[-1].strip()
    return (
        last.endswith(";")
        or not last
        or lines[0].lstrip().startswith(("\\", "quit", "exit"))
    )


def _answer(store: Store, query: str, format: str) -> None:
    from flows.cli.store_ask import named_table, schema_table

    word, _, rest = query.rstrip(";").strip().partition(" ")
    if word == "\\schema":
        print_table(schema_table(), format)
    elif word == "\\named" and not rest:
        print_table(named_table(), format)
    elif word == "\\named":
        name, *given = rest.split()
        if name not in NAMED:
            raise InputError(f"There is no query '{name}'; \\named lists them.")
        pairs = (one.partition("=") for one in given)
        values = {key: value for key, _, value in pairs}
        if set(values) != set(TAKES.get(name, {})):
            wanted = " ".join(f"{key}=..." for key in TAKES.get(name, {}))
            raise InputError(f"Expected \\named {name} {wanted}".rstrip() + ".")
        print_table(store.sql(NAMED[name][1], values), format)
    elif word.startswith("\\"):
        raise InputError(HELP)
    else:
        print_table(store.sql(query), format)
        tell_damage(store)


def _prepare(history: Path) -> None:
    import atexit
    import readline

    readline.set_completer(complete)
    readline.set_completer_delims(re.sub(r"[.\\]", "", readline.get_completer_delims()))
    readline.parse_and_bind("tab: complete")
    readline.set_history_length(KEPT)
    with suppress(OSError):
        readline.read_history_file(history)

    def save() -> None:
        with suppress(OSError):
            readline.write_history_file(history)

    atexit.register(save)
