"""Documents in the terminal: 80 columns, no color and no Unicode are enough."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text

from flows.outputs import say
from flows.report.document import Document, Heading, Note, ReportTable, Strong
from residual.errors import plain

# What a terminal without Unicode shows instead.
_PLAIN = str.maketrans({"→": ">", "±": "+", "–": "-", "²": "2", "³": "3", "·": ","})
_WIDE = 200
_NONE = ("", "–")


def show(
    console: Console, *parts: str | ReportTable | Note | Heading, wrapped: bool = False
) -> None:
    """Print sentences and tables, one after the other.

    Args:
        wrapped: Break sentences at the width of the terminal; without it they stay on
            one line, so that paths and commands can be copied.
    """
    for part in parts:
        text = getattr(part, "text", part)
        if isinstance(part, ReportTable):
            _print_table(console, part)
        elif isinstance(part, Heading):
            line(console, f"\n{text}", "bold")
        elif wrapped:
            line(console, text, "bold" if isinstance(text, Strong) else "")
        else:
            say(console, text)


def print_document(
    console: Console,
    document: Document,
    order: Sequence[str],
    after_warnings: Sequence[str] = (),
) -> None:
    """Print the brief form of a document.

    Args:
        order: Ids of its sections.
        after_warnings: Ids of the sections that follow the warnings.
    """
    line(console, "")
    line(console, " ".join([document.headline, *document.lead]), "bold")
    sections = {section.id: section for section in document.sections}
    for id in order:
        show(console, *filter(None, sections[id].brief), wrapped=True)
    for number, words in enumerate(document.warnings):
        line(console, f"{'' if number else chr(10)}Warning: {words}", "yellow")
    for id in after_warnings:
        show(console, *filter(None, sections[id].brief), wrapped=True)


def line(console: Console, text: str, style: str = "") -> None:
    """Print a sentence, wrapped at the width of the terminal, its indent kept."""
    words = _readable(console, Text(plain(text), style=style))
    indent = len(words.plain) - len(words.plain.lstrip(" "))
    padded = Padding(words[indent:], (0, 0, 0, indent), expand=False)
    console.print(padded if indent else words)


def wide_console(console: Console, width: int = _WIDE) -> Console:
    """Return a console that cuts nothing: into a file or a pipe as wide as it needs."""
    return console if console.is_terminal else Console(file=console.file, width=width)


def _print_table(console: Console, table: ReportTable) -> None:
    drawn = RichTable(box=SIMPLE_HEAD, show_edge=not table.title, pad_edge=False)
    for i, head in enumerate(table.heads):
        words = i in table.text_columns
        # Words wrap between words; numbers never.
        longest = max((len(w) for row in table.rows for w in row[i].split()), default=0)
        drawn.add_column(
            _readable(console, Text(head)),
            justify="left" if words else "right",
            no_wrap=not words,
            min_width=min(longest, console.width // 3) if words else None,
            max_width=table.max_widths.get(i),
            overflow="fold",
        )
    for number, row in enumerate(table.rows):
        if number in table.sections:
            drawn.add_section()
        drawn.add_row(*(_readable(console, _cell(cell)) for cell in row))
    if table.title:
        show(console, Heading(table.title), wrapped=True)
    if drawn.__rich_measure__(console, console.options).minimum <= console.width:
        console.print(drawn)
        return
    heads = [" ".join(head.split()) for head in table.heads[1:]]
    for first, *cells in table.rows:  # too narrow for columns: a row at a time
        pairs = zip(heads, cells, strict=True)
        words = ", ".join(f"{head} {cell}" for head, cell in pairs if cell not in _NONE)
        show(console, Strong(first), f"  {words}", wrapped=True)


def _cell(text: str) -> Text:
    # As text, so that nothing in a name is taken for markup.
    cell = Text(plain(text))
    if isinstance(text, Strong):
        cell.stylize("bold", 0, len(text.split("\n")[0]))
    return cell


def _readable(console: Console, text: Text) -> Text:
    """Return the text in characters that the terminal has."""
    if "utf" in console.encoding.lower():
        return text
    ascii = text.plain.translate(_PLAIN).encode("ascii", "replace").decode()
    return Text(ascii, style=text.style)
