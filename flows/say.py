"""A line for people, printed as it is: no markup, no colours, no breaks of our own."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def say(console: "Console", *lines: str) -> None:
    """Print lines that may hold brackets, paths and numbers."""
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
