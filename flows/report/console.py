"""Documents in the terminal: 80 columns, no colour and no Unicode are enough."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as Drawn
from rich.text import Text

from flows.outputs import say
from flows.report.document import Document, Heading, Note, Strong, Table
from residual.errors import plain

# What a terminal without Unicode shows instead.
_PLAIN = str.maketrans({"→": ">", "±": "+", "–": "-", "²": "2", "³": "3", "·": ","})
_WIDE = 200


def show(
    console: Console, *parts: str | Table | Note | Heading, wrapped: bool = False
) -> None:
    """Print sentences and tables, one after the other.

    Args:
        wrapped: Break sentences where the terminal ends; without it they stay whole, so
            that paths and commands can be taken over.
    """
    for part in parts:
        if isinstance(part, Table):
            _print_table(console, part)
        elif isinstance(part, Heading):
            line(console, f"\n{part.text}", "bold")
        elif wrapped:
            line(console, getattr(part, "text", part))
        else:
            say(console, getattr(part, "text", part))


def print_document(
    console: Console, told: Document, order: Sequence[str], last: Sequence[str] = ()
) -> None:
    """Print what a terminal has of a document.

    Args:
        order: Ids of its sections.
        last: Those that stand after what it warns of.
    """
    line(console, "")
    line(console, " ".join([told.headline, *told.lead]), "bold")
    sections = {section.id: section for section in told.sections}
    for id in order:
        show(console, *filter(None, sections[id].brief), wrapped=True)
    warnings = [words for part in told.callouts for words in part.lines]
    for number, words in enumerate(warnings):
        line(console, f"{'' if number else chr(10)}Warning: {words}", "yellow")
    for id in last:
        show(console, *filter(None, sections[id].brief), wrapped=True)


def line(console: Console, text: str, style: str = "") -> None:
    """Print a sentence, broken where the terminal ends."""
    console.print(_readable(console, Text(plain(text), style=style)))


def wide(console: Console, width: int = _WIDE) -> Console:
    """Return a console that cuts nothing: into a file or a pipe as wide as it needs."""
    return console if console.is_terminal else Console(file=console.file, width=width)


def _print_table(console: Console, table: Table) -> None:
    drawn = Drawn(box=SIMPLE_HEAD, show_edge=not table.title, pad_edge=False)
    for i, head in enumerate(table.heads):
        words = i in table.left
        drawn.add_column(
            _readable(console, Text(head)),
            justify="left" if words else "right",
            # Words may take several lines; numbers may not.
            no_wrap=not words,
            min_width=table.least.get(i),
            max_width=table.most.get(i),
            overflow="fold",
        )
    for number, row in enumerate(table.rows):
        if number in table.sections:
            drawn.add_section()
        drawn.add_row(*(_readable(console, _cell(cell)) for cell in row))
    if table.title:
        show(console, Heading(table.title))
    console.print(drawn)


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
    plain = text.plain.translate(_PLAIN).encode("ascii", "replace").decode()
    return Text(plain, style=text.style)
