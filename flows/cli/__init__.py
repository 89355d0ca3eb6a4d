"""The command line, `modelgap`: its commands by name, their output files, the text of errors.

A command is loaded when it runs, so that `modelgap --help` loads no numerics. Exit codes: 0
done, whatever the verdict; 1 the run failed; 2 bad usage or input; 130 interrupted.
"""

import errno
import json
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from cyclopts import App, CycloptsError, Group, MissingArgumentError
from cyclopts.exceptions import UnknownOptionError
from rich.console import Console

from flows.outputs import check_new_folder, check_writable, json_text, print_plain, write_files
from residual.errors import (
    LACKING,
    LINE,
    InputError,
    ModelgapError,
    NotAnIdError,
    RunError,
    build_missing_package_error,
    shorten_value,
    strip_control_characters,
)

_HELP = Path(__file__).with_name("help.txt").read_text("utf-8")

# By heading, in the order of the help: `commands` by name, each with MODULE:FUNCTION of
# flows.cli, the usage behind the name ("": that of Cyclopts) and the first sentence of
# the help. Those of a group with a `word` are listed below that word, and also run by
# their name alone.
GROUPS = json.loads(Path(__file__).with_name("commands.json").read_text("utf-8"))
_SHORTER = {"models": "list"}  # modelgap model list


def _version() -> str:
    from warehouse.code_provenance import format_version

    return format_version()


app = App(
    name="modelgap",
    help=_HELP,
    help_format="plaintext",  # what draws Markdown is a slow import
    version=_version,
    suppress_keyboard_interrupt=False,
)


app.command(
    "flows.cli.completion:install_completion",
    name="--install-completion",
    group="Options",
    help="Complete commands, options, files and stored ids in bash, zsh or fish.",
)
for flag in ("--help", "--version"):
    app[flag].group = "Options"


def _register() -> None:
    below = Group.create_ordered("More command groups")
    for heading, part in GROUPS.items():
        word, group = part.get("word"), Group.create_ordered(heading, sort_key=0)
        if word:
            inner = App(word, help=part["about"], version_flags=(), group=below)
            inner["--help"].group = "Options"
            app.command(inner)
        for number, (name, command) in enumerate(part["commands"].items()):
            _add(app, name, command, sort_key=number, group=group, show=not word)
            if word:
                _add(inner, _SHORTER.get(name, name), command, sort_key=number)


def _add(to: App, name: str, command: Sequence[str], **more: object) -> None:
    place, usage, about = command
    program = " ".join(["modelgap", *to.name[: to is not app]])
    usage = f"Usage: {program} {name} {usage} [OPTIONS]" if usage else None
    more |= {"help": about, "help_format": "markdown", "usage": usage}
    to.command(f"flows.cli.{place}", name=name, **more)


_register()


def run_command_line(arguments: Sequence[str]) -> None:
    """Run one command, given without the program's name; errors go to the caller."""
    # Cyclopts takes a lone "-" for an option unless "=" ties it to one.
    tied = re.sub(r"(^|\0)--json\0-(?=\0|$)", r"\1--json=-", "\0".join(arguments))
    arguments = tied.split("\0") if tied else []
    _, chain, _ = app.parse_commands(arguments)
    for each in chain:
        if each.default_command and not each.name[0].startswith("-"):
            each.help = None  # the help of one command is its whole docstring
    app(arguments, exit_on_error=False, print_error=False, result_action="return_value")


STDOUT = "-"
# Limits of experiments, as in flows/specs.py [s, -, Hz, -].
LONGEST, MOST_PERIODS, FASTEST, SEEDS = 600.0, 100, 20_000.0, 2**63 - 1

Make = Callable[[], str | bytes]


def check_option_range(option: str, value: float, low: float, high: float) -> None:
    """Raise InputError for a number outside its range, or NaN."""
    if not low <= value <= high:
        raise InputError(f"{option} {value:g}: expected {low:g} to {high:g}.")


class Outputs:
    """The files of a command: checked before the work, written whole after it.

    Attributes:
        files: The file of each option that was given.
        console: For people; standard error where JSON takes standard output.
    """

    def __init__(
        self,
        options: Mapping[str, str | None],
        inputs: Iterable[Path] = (),
        folder: str | None = None,
    ) -> None:
        """Check that every file can be written.

        Args:
            options: File by option, None where it was not given; "-" as --json is
                standard output.
            inputs: Files that are read and must not be overwritten.
            folder: The new folder of --out, None where it was not given.

        Raises:
            InputError: If a file cannot be written, two options name one, or the folder
                is not new.
        """
        named = {k: v for k, v in options.items() if v not in (None, STDOUT)}
        self.files = {option: Path(str(file)) for option, file in named.items()}
        check_writable(self.files, inputs)
        self._folder = None if folder is None else Path(folder)
        if self._folder is not None:
            check_new_folder("--out", self._folder)
        self._on_stdout = options.get("--json") == STDOUT
        self._json = ""
        self.console = Console(stderr=self._on_stdout)
        self._written: list[Path] = []

    def say(self, *lines: str) -> None:
        """Print lines for people."""
        print_plain(self.console, *lines)

    def write(
        self,
        make: Mapping[str, Make] | None = None,
        document: Callable[[], Mapping] | None = None,
        folder: Callable[[], Mapping[str, str | bytes]] | None = None,
    ) -> None:
        """Write the files, before anything is printed into a pipe that may be closed.

        Args:
            make: Function that returns the content of a file, by option.
            document: Function that returns the document of --json.
            folder: Function that returns the files of --out by name.
        """
        if document and (self._on_stdout or "--json" in self.files):
            self._json = json_text(document())
        contents: dict[Path, str | bytes] = {
            path: self._json if option == "--json" else (make or {})[option]()
            for option, path in self.files.items()
        }
        if folder and self._folder:
            self._folder.mkdir(exist_ok=True)
            contents |= {self._folder / name: content for name, content in folder().items()}
        write_files(contents)
        self._written += contents

    def finish(self, *lines: str) -> None:
        """Print which files were written, more lines, and the document of --json -."""
        self.say(*(f"wrote {path}" for path in self._written), *lines)
        if self._on_stdout:
            print(self._json, end="")


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # EFBIG: a quota, ulimit -f
_NO_SPACE = "No space left"  # in errors of libraries that have no errno
_BAD_NAME = (errno.ENAMETOOLONG, errno.ELOOP)
_LOOP = "Symlink loop"  # in errors of pathlib up to Python 3.12, which have no errno
_LONG_WORD = re.compile(rf"\S{{{2 * LINE},}}")
_INSTEAD = {
    "a verdict": "Expected the id of a stored diagnosis: modelgap sql "
    "'SELECT diagnosis_id FROM diagnoses'.",
    "a model": "Give it to modelgap predict with --model, to modelgap export as MODEL.",
    None: "modelgap import gives a log an id.",
}
# Options of other commands, with the alternative here.
_NO_OPTION = {
    ("calibrate", "--holdout"): "calibrate validates by leaving out each log (or "
    "blocks of a single log) in turn: give all logs as LOG.",
    ("monitor", "--robot"): "MODEL is the robot, or the id of a diagnosis.",
}
TRACEBACK = "MODELGAP_TRACEBACK"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code.

    Args:
        arguments: Command line without the program's name; None for that of the
            process.
    """
    try:
        # Inside, so that an interruption while loading is caught too.
        run_command_line(sys.argv[1:] if arguments is None else list(arguments))
        sys.stdout.flush()
    except KeyboardInterrupt:
        return _print_error("interrupted", 130)
    except BrokenPipeError:
        # The reader of our output has gone; flushing at exit must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        return _explain(error)
    return 0


def _explain(error: Exception) -> int:
    """Print an error in one or two lines and return the exit code."""
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    error = _missing_package(error) or error
    if isinstance(error, ModelgapError):
        return _print_error(f"{error}{_file_hint(error)}", 2)
    if isinstance(error, RunError):
        return _print_error(str(error), 1)
    if isinstance(error, CycloptsError):
        command = " ".join(error.command_chain or ())
        text = _describe_usage_error(error, command)
        return _print_error(f"{text} See {f'modelgap {command}'.strip()} --help.", 2)
    number = error.errno if isinstance(error, OSError) else None
    message = " ".join(f"{type(error).__name__}: {error}".split())
    if number in _BAD_NAME or _LOOP in message:
        return _print_error(
            f"{shorten_value(message)}. Expected the path of a file or a folder.", 2
        )
    if number in _FULL or _NO_SPACE in message:
        return _print_error(
            "The disk is full. Nothing was lost: unfinished work is not stored.\n"
            "Free some space and run the same command again.",
            1,
        )
    if number == errno.EROFS:
        place = getattr(error, "filename", None) or "The disk"
        return _print_error(f"{place} is read-only. Nothing was written or lost.", 1)
    return _print_error(f"unexpected failure: {message}\nSet {TRACEBACK}=1 to see where.", 1)


def _describe_usage_error(error: CycloptsError, command: str) -> str:
    # Cyclopts calls an option that was left out one without its value.
    if isinstance(error, MissingArgumentError) and error.keyword is None:
        argument = error.argument
        metavar = argument.parameter.metavar if argument.name.startswith("-") else None
        return f"{command} needs {' '.join(filter(None, (argument.name, metavar)))}."
    if isinstance(error, UnknownOptionError):
        option = (error.token.keyword or error.token.value).partition("=")[0]
        if instead := _NO_OPTION.get((command.split()[-1], option)):
            return f"Unknown option: {option}. {instead}"
    return " ".join(str(error).split())


def _file_hint(error: ModelgapError) -> str:
    """Return what to add where a file was given in place of an id."""
    if not isinstance(error, NotAnIdError):
        return ""
    from residual.model.model_files import identify_file_content

    try:
        kind = identify_file_content(error.args[1])
    except (OSError, ValueError):
        return ""
    return f"\nThe file holds {kind}. {_INSTEAD.get(kind, _INSTEAD[None])}"


def _missing_package(error: BaseException | None) -> Exception | None:
    """Return the error for a missing optional package in the chain of causes."""
    while error is not None:
        if isinstance(error, ModuleNotFoundError):
            name = (error.name or "").partition(".")[0]
            return build_missing_package_error(name) if name in LACKING else None
        error = error.__cause__
    return None


def _print_error(text: str, code: int) -> int:
    # Text out of a log must not control the terminal.
    short = _LONG_WORD.sub(lambda word: shorten_value(word[0]), text)
    print(f"modelgap: {strip_control_characters(short)}", file=sys.stderr)
    return code
