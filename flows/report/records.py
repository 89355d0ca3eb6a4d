"""Records and logs in the terminal: one record, two, a rerun, the lineage."""

from collections.abc import Mapping
from dataclasses import asdict

from rich.console import Console
from rich.markup import escape
from rich.tree import Tree

from flows.report.document import ReportTable, build_text_table
from flows.steps.imports import ImportedLog
from residual.errors import strip_control_characters
from residual.robot.robot import Robot
from warehouse.logs.column_map import abbreviate_column_names

_SHOWN = 40  # lines of one table
_LISTED = 12  # channels of a rerun that are listed for people


def build_diff_tables(difference) -> list[str | ReportTable]:
    """Return a comparison of two records: which values differ, and by how much."""
    same = "the same values" if difference.same else "different values"
    parts = [f"{difference.kind} {difference.ids[0]} and {difference.ids[1]}: {same}"]
    for heading, rows in difference.tables.items():
        if not rows:
            parts.append(f"{heading}: the same")
            continue
        shown = [[_word(part) for part in row] for row in rows[:_SHOWN]]
        heads = (heading, *(id[:8] for id in difference.ids))
        parts.append(build_text_table(heads, shown))
        parts += _more(len(rows))
    if difference.kind != "runs":
        # Numbers of the record are in its table; files and tables are not.
        parts += [channel.words for channel in difference.channels[:_SHOWN]]
        return parts + _more(len(difference.channels))
    rows = []
    for c in difference.channels:
        count = str(c.differing) if c.differing or not c.note else c.note
        figures = ["–" if v is None else f"{v:.4g}" for v in (c.first, c.largest, c.rms)]
        differ = "equal" if c.equal else count
        rows.append((c.name, c.unit or "–", str(c.rows), differ, *figures))
    heads = ("channel", "unit", "samples", "differ", "from [s]", "largest", "rms")
    return [*parts, build_text_table(heads, rows)]


def build_diff_record(difference) -> dict:
    """Return a comparison as JSON can hold it."""
    tables = {
        heading: [{"name": n, "one": one, "two": two} for n, one, two in rows]
        for heading, rows in difference.tables.items()
    }
    return {
        "kind": difference.kind,
        "one": difference.ids[0],
        "two": difference.ids[1],
        "same": difference.same,
        **tables,
        "data": [asdict(channel) for channel in difference.channels],
    }


def print_tree(root, words: str, console: Console) -> None:
    """Print a record and its relatives."""

    def name(relative) -> str:
        return f"{relative.kind or 'not in this store'} {escape(relative.id)}"

    def grow(tree: Tree, root) -> None:
        for each in root.relatives:
            again = ", see above" if each.again else ""
            grow(tree.add(f"{escape(each.role)}: {name(each)}{again}"), each)

    tree = Tree(f"{name(root)}, {words}{'' if root.relatives else ': nothing'}")
    grow(tree, root)
    console.print(tree, highlight=False)


def _more(count: int) -> list[str]:
    remaining = count - _SHOWN
    return [f"and {remaining} more; --format json has all"] if remaining > 0 else []


def _word(value: object) -> str:
    text = "–" if value is None else str(value)
    return text if len(text) <= 64 else f"{text[:61]}..."


_LONG = 200  # characters of a text beyond which a line shows its start


def format_record_lines(value: Mapping | list, indent: str = "") -> list[str]:
    """Return a nested record as lines: key, then its value or lines below it."""
    lines = []
    items = value.items() if isinstance(value, Mapping) else (("-", v) for v in value)
    for key, item in items:
        parts = item if isinstance(item, list) else [item]
        if any(isinstance(part, Mapping | list) and part for part in parts):
            lines += [
                strip_control_characters(f"{indent}{key}:"),
                *format_record_lines(item, indent + "  "),
            ]
        else:
            lines.append(strip_control_characters(f"{indent}{key}: {_value(item)}"))
    return lines


def _value(item: object) -> str:
    if isinstance(item, list):
        return ", ".join(_value(part) for part in item) or "–"
    text = "–" if item is None or item == {} else str(item)
    if len(text) <= _LONG:
        return text
    return f"{' '.join(text[:60].split())} … ({len(text)} characters, --format json)"


def describe_rerun(rerun) -> list[str]:
    """Return the result of a rerun, line by line."""
    about = f"{rerun.kind} {rerun.id}"
    if rerun.reproduced and rerun.imported:
        return [f"{about}: measured; its values are those of the import"]
    if rerun.reproduced:
        code = "" if rerun.same_code else "; the code has changed, the values have not"
        out = [f"{about}: same, bit for bit{code}"]
    else:
        out = [f"{about}: not the same"]
        out += [f"  {channel.words}" for channel in rerun.differences[:_LISTED]]
        if len(rerun.differences) > _LISTED:
            out.append(f"  and {len(rerun.differences) - _LISTED} more")
        out.append(f"most probable cause: {rerun.cause.kind}: {rerun.cause.why}")
    out.append(rerun.changes)
    if rerun.new_id:
        out.append(f"stored, a rerun of it: modelgap show {rerun.new_id}")
    if rerun.note_id:
        out.append(f"kept on record: modelgap show {rerun.note_id}")
    return out


def build_rerun_record(rerun) -> Mapping:
    """Return the same as JSON can hold it."""
    keys = ["id", "kind", "reproduced", "same_code", "imported", "changes"]
    return {
        **{key: getattr(rerun, key) for key in keys},
        "made": rerun.new_id,
        "noted": rerun.note_id,
        "differences": [asdict(channel) for channel in rerun.differences],
        "cause": rerun.cause and asdict(rerun.cause),
    }


def build_channel_table(log: ImportedLog) -> ReportTable:
    """Return the column of a log behind each channel, and its conversion."""
    heads = ("channel", "column", "unit in the file", "conversion")
    rows = [(c, column, unit, done or "–") for c, column, unit, done in log.summary.channels]
    return build_text_table(heads, rows)


def describe_imported_log(log: ImportedLog, robot: Robot, all: bool) -> list[str]:
    """Return how a log was read, one line each."""
    known = log.summary
    if not all:
        return [known.text, *(f"warning: {w}" for w in known.warnings)]
    joints = ", ".join(f"{i} {name}" for i, name in enumerate(robot.joints, 1))
    gaps = [w for w in known.warnings if "gap(s)" in w]
    window = f", window @{known.window}" if known.window else ""
    return [
        f"log: {known.file}{window}",
        f"robot: {robot.name}, {robot.dof} joints: {joints}",
        f"rows: {known.rows}, {known.rate:.6g} Hz, {known.duration:.6g} s, from "
        f"t = {log.recording.t[0]:.9g} s",
        *([] if gaps else ["gaps: none"]),
        *(f"warning: {warning}" for warning in known.warnings),
        *(f"file: {note}" for note in known.notes),
        f"recorded: {log.manifest['recorded_at'] or 'unknown; see --recorded-at'}",
        f"serial number: {log.manifest['serial'] or 'none'}, "
        f"tags: {' '.join(log.manifest['tags']) or 'none'}",
        f"ignored columns: {abbreviate_column_names(known.ignored) or 'none'}",
        f"run id: {log.run_id}, {'in the store already' if log.stored else 'new'}; "
        "a dry run stores nothing",
    ]
