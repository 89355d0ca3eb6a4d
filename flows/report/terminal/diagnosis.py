"""The verdict in the terminal: one sentence first, then the tables behind it."""

from collections.abc import Iterable, Sequence

from rich import box
from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from flows.report.words import outlook
from flows.report.words import rows as tables
from flows.report.words.outlook import other_sets
from flows.report.words.rows import METRICS, ErrorRow, FindingRow
from flows.report.words.staged import Staged, baseline_sentences
from flows.report.words.verdict import headline, rising
from residual.diagnosis.result import PLAIN, STAGES, Diagnosis
from residual.quantity import bare_percent, known, probability

# What a terminal without Unicode shows instead.
_PLAIN = str.maketrans({"→": ">", "±": "+", "–": "-", "²": "2", "³": "3", "·": ","})
# Broken by hand, so that eighty columns hold all of them.
_HEADS = {"identified": "identi-\nfied", "augmented": "aug-\nmented"}
_PAIR = 12  # characters of an error before and after
_NARROW = 26
_TRUTH = ("", "hidden", "found")


def print_diagnosis(found: Diagnosis, console: Console, verbose: bool = False) -> None:
    """Print a diagnosis: verdict, findings, errors, what is left, what to do next.

    Args:
        console: Where to print; 80 columns and no colour are enough.
        verbose: List the effects that these logs could not tell apart.
    """
    _line(console, "")
    _line(console, headline(found.verdict), "bold")
    answer = (_findings, _edits, _given, _errors)
    for part in (*answer, _left_over, _detectable, _warnings, _next):
        part(found, console)
    if verbose and not found.effects:
        for pair in outlook.confusable_pairs(found.verdict):
            _line(console, f"  look alike: {pair}")
    _line(console, "")


def print_truth(staged: Staged, console: Console) -> None:
    """Print what was hidden beside what was found."""
    table = _table("The seal, opened after the verdict was stored", _TRUTH)
    for row in staged.rows:
        _row(console, table, map(Text, row))
    _print(console, table)
    for line in (staged.judged, *staged.edits):
        _line(console, line)
    if staged.forms:
        _line(console, staged.forms)


def _findings(found: Diagnosis, console: Console) -> None:
    rows = tables.findings(found)
    if not rows:
        return
    table = _table("What is missing", ("", "effect", "parameters", "evidence"))
    lines = [line for f in rows for line in tables.parameter_lines(f, _NARROW)]
    table.columns[2].min_width = max(map(len, lines), default=0)
    for finding in rows:
        cells = (
            Text(finding.order),
            _effect_cell(finding),
            Text("\n".join(tables.parameter_lines(finding, _NARROW))),
            _evidence_cell(finding),
        )
        _row(console, table, cells)
    _print(console, table)
    for line in other_sets(found.verdict):
        _line(console, line)


def _given(found: Diagnosis, console: Console) -> None:
    rows = outlook.off_rows(found.verdict)
    if not rows:
        return
    heads = ("value", "as given", "as the logs have it", "")
    table = _table("Given values that the logs do not bear out", heads)
    for row in rows:
        _row(console, table, map(Text, row))
    _print(console, table)
    if more := outlook.hidden_rows(found.verdict):
        _line(console, f"and {more} more: 'changes' in the JSON has all of them.")


def _edits(found: Diagnosis, console: Console) -> None:
    for line in baseline_sentences(found.verdict):
        _line(console, line)


def _effect_cell(finding: FindingRow) -> Text:
    cell = Text(finding.title, style="bold")
    if finding.alternatives:
        same = " or ".join(finding.alternatives)
        cell.append(f"\nor {same}: these data cannot tell", style="not bold")
    return cell


def _evidence_cell(finding: FindingRow) -> Text:
    lines = [f"{finding.nats} nats"]
    if finding.by:
        lines.append(f"by {finding.by}")
    if known(finding.probability):
        lines.append(f"this name: {probability(finding.probability)}")
    lines.append(f"held-out: {finding.verdict}")
    if finding.splits:
        lines.append(f"found again: {finding.splits}")
    return Text("\n".join(lines))


def _errors(found: Diagnosis, console: Console) -> None:
    lines = tables.error_rows(found)
    columns = _error_columns(lines)
    if not columns:
        return
    share = any(known(row.unexplained) for row in lines)
    heads = ["joint", *(head for head, _, _ in columns)]
    heads += ["unex-\nplained"] if share else []
    table = _table(_error_title(found, columns[0][1]), heads, "right")
    for column, (_, _, stages) in zip(table.columns[1:], columns, strict=False):
        column.min_width = _PAIR if len(stages) > 1 else None
    for row in lines:
        cells = [Text(row.label)]
        cells += [_error_cell(row, metric, stages) for _, metric, stages in columns]
        if share:
            flag = " !" if row.flagged else "  "
            cells.append(Text(bare_percent(row.unexplained) + flag))
        _row(console, table, cells)
    _print(console, table)
    if len(columns[-1][2]) > 1:
        _line(console, "Arrows: identified (refit without the findings) → augmented.")
    worse = rising(found.verdict)
    if worse:
        _line(console, f"Worse with the findings: {', '.join(worse)} (moving).")


def _error_columns(lines: Sequence[ErrorRow]) -> list[tuple]:
    """Return (heading, metric, stages): stages in full for the first metric known."""
    metrics = [metric for metric in METRICS if _any(lines, metric)]
    if not metrics:
        return []
    # Two are as many as eighty columns hold; the page and the JSON have the third.
    first, *others = metrics[:2]
    shown = [s for s in STAGES if tables.has(lines, first, s)]
    columns = [(_HEADS.get(s, s), first, (s,)) for s in shown]
    if tables.has(lines, first, PLAIN):
        columns.append(("least\nsquares", first, (PLAIN,)))
    pair = ("identified", "augmented")
    return columns + [(METRICS[metric], metric, pair) for metric in others]


def _any(lines: Sequence[ErrorRow], metric: str) -> bool:
    return any(tables.has(lines, metric, s) for s in ("nominal", "identified"))


def _error_cell(row: ErrorRow, metric: str, stages: Sequence[str]) -> Text:
    values = [row.values[metric].get(stage) for stage in stages]
    shown = [bare_percent(value) for value in values]
    if len(shown) == 1:
        return Text(shown[0], style="bold" if stages == ("augmented",) else "")
    if not any(map(known, values)):
        return Text("")
    return Text(f"{shown[0]} → {shown[1]:>5}")


def _error_title(found: Diagnosis, metric: str) -> str:
    where = f" on {', '.join(found.errors.logs)}" if found.errors.logs else ""
    weak = " (the same run: a weak proof)" if found.errors.same_run else ""
    return f"Held-out error{where}{weak}, {METRICS[metric]}, % of torque"


def _left_over(found: Diagnosis, console: Console) -> None:
    sentences = outlook.unexplained_words(found.verdict)
    if sentences:
        _line(console, "")
        _line(console, " ".join(sentences))


def _detectable(found: Diagnosis, console: Console) -> None:
    heads, lines = outlook.detectable_rows(found.verdict, short=True)
    if found.effects or not lines:
        return
    title = "Smallest size that would have been found"
    table = _table(title, heads, "right")
    table.padding = (0, 1, 0, 0)
    table.columns[1].justify = "left"
    # The longest word of a name, so that none is broken.
    words = [word for line in lines for word in line[0].split()]
    table.columns[0].min_width = max(map(len, words))
    for line in lines:
        _row(console, table, map(Text, line))
    _print(console, table)
    if any(outlook.NEVER in line for line in lines):
        _line(console, f"{outlook.NEVER}: not detectable here; no arm has so much.")
    alike = outlook.confusable_words(found.verdict)
    if alike:
        _line(console, f"{alike} --verbose lists them.")


def _warnings(found: Diagnosis, console: Console) -> None:
    if found.warnings:
        _line(console, "")
    for warning in found.warnings:
        _line(console, f"Warning: {warning}", "yellow")


def _next(found: Diagnosis, console: Console) -> None:
    lines = outlook.next_words(found.verdict)
    if lines:
        _line(console, "\nNext experiment:", "bold")
    for line in lines:
        _line(console, f"  {line}")


def _table(title: str, heads: Sequence[str], justify: JustifyMethod = "left") -> Table:
    table = Table(
        title=title,
        title_style="bold",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
    )
    for i, head in enumerate(heads):
        # Short cells keep their width, so that no verdict is cut at 80 columns.
        least = len("held-out: confirmed") if head == "evidence" else None
        side = "left" if i == 0 else justify
        table.add_column(head, justify=side, min_width=least, overflow="fold")
    return table


def _print(console: Console, table: Table) -> None:
    _line(console, "")
    # As text, so that nothing in a name is taken for markup.
    table.title = _readable(console, Text(str(table.title), style="bold"))
    for column in table.columns:
        column.header = _readable(console, Text(str(column.header)))
    console.print(table)


def _row(console: Console, table: Table, cells: Iterable[Text]) -> None:
    table.add_row(*(_readable(console, cell) for cell in cells))


def _line(console: Console, text: str, style: str = "") -> None:
    console.print(_readable(console, Text(text, style=style)))


def _readable(console: Console, text: Text) -> Text:
    """Return the text in characters that the terminal has."""
    if "utf" in console.encoding.lower():
        return text
    plain = text.plain.translate(_PLAIN).encode("ascii", "replace").decode()
    return Text(plain, style=text.style)
