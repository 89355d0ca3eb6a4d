"""What the commands have in common: limits of numbers, and files that they write."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from rich.console import Console

from flows.outputs import check_writable, json_text, say, write_all
from residual.errors import InputError

STDOUT = "-"
# As in the files of experiments (flows/specs/experiment.py).
LONGEST, MOST_PERIODS, FASTEST, SEEDS = 600.0, 100, 20_000.0, 2**63 - 1

Make = Callable[[], str | bytes]


def check_between(option: str, value: float, low: float, high: float) -> None:
    """Refuse a number that no run ends with.

    Raises:
        InputError: If it is not from low to high, or no number.
    """
    if not low <= value <= high:
        raise InputError(f"{option} {value:g}: expected {low:g} to {high:g}.")


def check_workers(count: int | None) -> None:
    """Refuse a number of processes below one.

    Raises:
        InputError: If it is.
    """
    if count is not None and count < 1:
        raise InputError(f"--workers is {count}, expected 1 or more.")


class Outputs:
    """The files of a command: checked before the work, written whole after it.

    Attributes:
        files: Where each option wants its file.
        console: Where people read: standard error where JSON has the output for itself.
        wrote: Files that were written.
    """

    def __init__(
        self, options: Mapping[str, str | None], inputs: Iterable[Path] = ()
    ) -> None:
        """Refuse early what could not be written at the end.

        Args:
            options: What was given; "-" as --json is standard output and no file.
            inputs: Files that are read and must not be lost.

        Raises:
            InputError: If a file cannot be written, or two options name one.
        """
        named = {k: v for k, v in options.items() if v not in (None, STDOUT)}
        self.files = {option: Path(str(file)) for option, file in named.items()}
        check_writable(self.files, inputs)
        self._on_stdout = options.get("--json") == STDOUT
        self._json = ""
        self.console = Console(stderr=self._on_stdout)
        self.wrote: list[Path] = []

    def say(self, *lines: str) -> None:
        """Print lines for people."""
        say(self.console, *lines)

    def write(
        self,
        make: Mapping[str, Make] | None = None,
        document: Callable[[], Mapping] | None = None,
        also: Mapping[Path, str | bytes] | None = None,
    ) -> None:
        """Write the files; before anything is printed that may go into a closed pipe.

        Args:
            make: What makes the content of a file, by its option.
            document: What makes the document of --json.
            also: Files that no option of a single file names.
        """
        contents: dict[Path, str | bytes] = {}
        if document and (self._on_stdout or "--json" in self.files):
            self._json = json_text(document())
        for option, path in self.files.items():
            contents[path] = self._json if option == "--json" else make[option]()
        contents |= also or {}
        write_all(contents)
        self.wrote += contents

    def finish(self, *lines: str) -> None:
        """Say what was written, then some lines, then the document if it was asked."""
        self.say(*(f"wrote {path}" for path in self.wrote), *lines)
        if self._on_stdout:
            print(self._json, end="")
