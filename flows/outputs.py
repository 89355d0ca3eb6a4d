"""Output to the user: lines, progress, and files written whole or not at all."""

import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import monotonic

from rich.console import Console

from residual.errors import InputError, strip_control_characters


def json_text(document: Mapping) -> str:
    """Return a document as JSON text; NaN is refused."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def describe_repair_file(lines: str) -> str:
    """Return where repair lines belong, in words."""
    return "robot.toml, [robot]" if lines.startswith("grav") else "--map"


def check_writable(files: Mapping[str, Path], inputs: Iterable[Path]) -> None:
    """Check, before the work, that the files can be written after it.

    Raises:
        InputError: If a folder does not exist or is not writable, a file is a folder or
            an input, or two options name one file.
    """
    read = {path.resolve() for path in inputs}
    seen: dict[Path, str] = {}
    for option, path in files.items():
        place = path.resolve()
        if path.is_dir():
            raise InputError(f"{option} {path} is a folder, expected a file name.")
        if not place.parent.is_dir():
            raise InputError(
                f"{option} {path}: there is no folder '{path.parent}'. Create it first."
            )
        # Still a link: one of a circle (Python 3.13 resolves it without an error).
        if place.is_symlink() or not _can_write(place):
            raise InputError(
                f"{option} {path} cannot be written. Name another file, or change the permissions."
            )
        if place in read:
            raise InputError(f"{option} {path} would overwrite an input file.")
        if place in seen:
            raise InputError(f"{seen[place]} and {option} both name {path}.")
        seen[place] = option


def check_outside(file: str | None, store: Path) -> None:
    """Raise InputError for an --out among the records of a store."""
    from warehouse.view_schema import FOLDERS

    place, store = Path(file or store).resolve(), store.resolve()
    # The folder of a store may hold other files too.
    inside = place.relative_to(store).parts[:1] if place.is_relative_to(store) else ()
    if set(inside) & FOLDERS:
        raise InputError(f"--out {file} is among the records of the store. Choose another folder.")


def check_new_folder(option: str, place: Path) -> None:
    """Raise InputError for an export folder that is not new."""
    if place.exists() and not place.is_dir():
        raise InputError(f"{option} {place} is a file, expected a folder.")
    if place.is_dir() and any(place.iterdir()):
        raise InputError(
            f"{option} {place} is not empty. Name a new folder: nothing is overwritten."
        )
    if not place.resolve().parent.is_dir():
        raise InputError(f"{option} {place}: there is no folder '{place.parent}'. Create it first.")


def list_input_files(words: Iterable[str], *files: str | None) -> list[Path]:
    """Return the files that a command may read, with and without a log window."""
    from residual.robot.robot import parse_robot_reference

    words = [place for word in words for place in {word, parse_robot_reference(word)[0]}]
    windowless = (word.rpartition("@")[0] for word in words)
    return [Path(word) for word in (*words, *windowless, *files) if word]


def _can_write(place: Path) -> bool:
    """Try it: permission bits are not enough for /sys, /proc and read-only mounts."""
    if place.exists() and not os.access(place, os.W_OK):
        return False
    if place.exists() and not place.is_file():
        return True
    try:
        with tempfile.TemporaryFile(dir=place.parent):
            return True
    except OSError:
        return False


def write_files(contents: Mapping[Path, str | bytes]) -> None:
    """Write files, text or bytes by path, each whole or not at all."""
    for path, content in contents.items():
        data = content.encode() if isinstance(content, str) else content
        _write(path.resolve(), data)


def _write(path: Path, data: bytes) -> None:
    # A device or pipe cannot be renamed over without destroying it.
    if path.exists() and not path.is_file():
        path.write_bytes(data)
        return
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        # mkstemp creates private files; give a report the mode of any new file.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def print_plain(console: Console, *lines: str) -> None:
    """Print lines as they are, without markup."""
    for line in lines:
        console.print(strip_control_characters(line), markup=False, highlight=False, soft_wrap=True)


def print_damaged_files(damaged: Iterable[str]) -> None:
    """Print on standard error which files of a store cannot be read."""
    for line in damaged:
        print(f"modelgap: left out: {line}", file=sys.stderr)


# Called with the stage and the fraction done.
Progress = Callable[[str, float], None]
Clock = Callable[[], float]
PAUSE = 15.0  # s between two lines of progress in a log file


def print_progress_lines(say: Callable[[str], None], clock: Clock = monotonic) -> Progress:
    """Return a function that prints progress as lines, at most one per PAUSE."""
    last = [clock()]

    def tell(stage: str, done: float) -> None:
        if clock() - last[0] >= PAUSE:
            last[0] = clock()
            say(f"{done:4.0%} {stage}")

    return tell


@contextmanager
def show_progress_bar() -> Iterator[Progress]:
    """Show a progress bar until the block ends.

    Yields:
        A function that takes the stage and the fraction done. If standard error is not
        a terminal, it prints a plain line every PAUSE seconds.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield print_progress_lines(lambda line: print(line, file=sys.stderr, flush=True))
        return
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    bar = Bar(
        BarColumn(bar_width=24),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
        console=console,
        transient=True,
        # Rich would redirect standard output to standard error.
        redirect_stdout=False,
        redirect_stderr=False,
    )
    task = bar.add_task("", total=1.0)

    def tell(stage: str, done: float) -> None:
        bar.start()
        bar.update(task, description=stage, completed=done)

    try:
        yield tell
    finally:
        bar.stop()
