"""All commands by name and group, each loaded only when it runs; what they share.

Only here, and for optional extras, is anything loaded late: `modelgap --help` loads no
numerics, and a command loads what it needs and no more.
"""

import errno
import os
import re
import sys
import tomllib
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from cyclopts import (
    App,
    CycloptsError,
    Group,
    MissingArgumentError,
    UnusedCliTokensError,
)
from rich.console import Console

from flows.outputs import check_writable, json_text, say, write_all
from residual.errors import (
    LACKING,
    LINE,
    InputError,
    ModelgapError,
    NotAnIdError,
    RunError,
    not_installed,
    plain,
    shortened,
)

_HELP = """Find what a robot's dynamic model is missing.

The missing effect (friction, payload, spring, a sensor that is off) is named,
added to the model, and proved on motion that was not fitted: for dynamic
identification, payload identification, friction compensation, feed-forward.
Start with one of these:

 modelgap demo
 modelgap diagnose A.csv B.csv --robot arm.urdf --holdout C.csv

The first makes an arm with an effect that its model does not have; the second
takes your own logs. 'modelgap COMMAND --help' explains a command; 'modelgap
store', 'modelgap model' and so on list more of them.

Exit codes: 0 done, whatever the verdict; 1 the run failed; 2 bad usage or
input; 130 interrupted.
"""

# By group: its `commands` by name, each (MODULE:FUNCTION of `flows.cli`, usage, about).
GROUPS = tomllib.loads(Path(__file__).with_name("commands.toml").read_text("utf-8"))
_SHORTER = {"models": "list"}  # below its word


def _version() -> str:
    from warehouse.provenance import version_text

    return version_text()


app = App(
    name="modelgap",
    help=_HELP,
    help_format="plaintext",  # what draws Markdown is a slow import
    version=_version,
    suppress_keyboard_interrupt=False,
)
app.register_install_completion_command(add_to_startup=False)
for flag in ("--help", "--version", "--install-completion"):
    app[flag].group = "Options"


def _register() -> None:
    below = Group.create_ordered("More, a word each")
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


def run(words: Sequence[str]) -> None:
    """Run one command; every error is left to the caller.

    Args:
        words: Command line without the program's name.

    Raises:
        CycloptsError: On bad usage.
    """
    # The parser takes a lone "-" for an option unless it is tied to one.
    tied = re.sub(r"(^|\0)--(json|file)\0-(?=\0|$)", r"\1--\2=-", "\0".join(words))
    # Without a name it asks which there are.
    tied = re.sub(r"(^|\0)--named(?=\0-|$)", r"\1--named=list", tied)
    words = tied.split("\0") if tied else []
    _, chain, _ = app.parse_commands(words)
    for each in chain:
        if each.default_command and not each.name[0].startswith("-"):
            each.help = None  # its docstring has more than lists do
    app(
        words,
        exit_on_error=False,
        print_error=False,
        result_action="return_value",
    )


# What the commands have in common: limits of numbers, and files that they write.


STDOUT = "-"
_PICTURES = {"--plot": ".png", "--gif": ".gif"}  # what they write, whatever the name
# As in the files of experiments (flows/specs/experiment.py).
LONGEST, MOST_PERIODS, FASTEST, SEEDS = 600.0, 100, 20_000.0, 2**63 - 1

Make = Callable[[], str | bytes]


def check_between(option: str, value: float, low: float, high: float) -> None:
    """Refuse a number that no run ends with."""
    if not low <= value <= high:
        raise InputError(f"{option} {value:g}: expected {low:g} to {high:g}.")


def check_workers(count: int | None) -> None:
    """Refuse a number of processes below one."""
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
            InputError: If a file cannot be written, two options name one, or a name
                says that it is another kind of picture.
        """
        named = {k: v for k, v in options.items() if v not in (None, STDOUT)}
        self.files = {option: Path(str(file)) for option, file in named.items()}
        check_writable(self.files, inputs)
        for option, ending in _PICTURES.items():
            path = self.files.get(option)
            if path and path.suffix.lower() not in ("", ending):
                raise InputError(f"{option} {path}: expected a file *{ending}.")
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


# Also a file that may not grow, by a quota or by ulimit -f.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_SPACE = "No space left"  # where a library gives no number
_NO_NAME = (errno.ENAMETOOLONG, errno.ELOOP)  # no file can be called so
_LOOP = "Symlink loop"  # what pathlib says, up to Python 3.12, without a number
_WORD = re.compile(rf"\S{{{2 * LINE},}}")
_INSTEAD = {
    "a verdict": "what is stored of a diagnosis of runs has an id: modelgap sql "
    "'SELECT diagnosis_id FROM diagnoses'.",
    "a model": "modelgap predict takes such a file with --model, and modelgap export "
    "as its first word.",
    None: "a log becomes a run with an id by modelgap import.",
}
TRACEBACK = "MODELGAP_TRACEBACK"


def main(words: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        words: Command line without the program's name; None for the process's own.

    Returns:
        The exit code.
    """
    try:
        # Inside, so that an interruption while loading is answered too.
        run(sys.argv[1:] if words is None else list(words))
        sys.stdout.flush()
    except KeyboardInterrupt:
        return _say("interrupted", 130)
    except BrokenPipeError:
        # The reader of our output has gone; what is left must not fail at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        return _explain(error)
    return 0


def _explain(error: Exception) -> int:
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    error = _lacking(error) or error
    if isinstance(error, ModelgapError):
        return _say(f"{error}{_of_file(error)}", 2)
    if isinstance(error, RunError):
        return _say(str(error), 1)
    if isinstance(error, CycloptsError):
        return _say(_misused(error), 2)
    if (isinstance(error, OSError) and error.errno in _NO_NAME) or _LOOP in str(error):
        named = getattr(error, "filename", None) or str(error).partition("'")[2]
        why = getattr(error, "strerror", None) or "a link to itself"
        return _say(
            f"'{shortened(str(named).strip(chr(39)))}' is the name of no file: {why}. "
            "Expected the path of a file or a folder.",
            2,
        )
    what = " ".join(f"{type(error).__name__}: {error}".split())
    if (isinstance(error, OSError) and error.errno in _FULL) or _NO_SPACE in what:
        return _say(
            "the disk is full; nothing was lost: what was not finished is not stored, "
            "all else is as it was.\nMake room and give the same command again.",
            1,
        )
    if isinstance(error, OSError) and error.errno == errno.EROFS:
        return _say(
            f"{error.filename or 'the disk'} is on a read-only disk; nothing was "
            "written and nothing was lost.",
            1,
        )
    return _say(f"unexpected failure: {what}\nSet {TRACEBACK}=1 to see where.", 1)


def _of_file(error: ModelgapError) -> str:
    """Return what to add where a word that is no id is the name of a file."""
    if not isinstance(error, NotAnIdError):
        return ""
    from residual.model.record import held_in

    try:
        kind = held_in(error.args[1])
    except (OSError, ValueError):
        return ""
    return f"\nIt is a file that holds {kind}; {_INSTEAD.get(kind, _INSTEAD[None])}"


def _lacking(error: BaseException | None) -> Exception | None:
    """Return what to say where a package that not every machine has is behind it."""
    while error is not None:
        if isinstance(error, ModuleNotFoundError):
            name = (error.name or "").partition(".")[0]
            return not_installed(name) if name in LACKING else None
        error = error.__cause__
    return None


def _misused(error: CycloptsError) -> str:
    """Return what is wrong, and whose help says what would be right."""
    chain = error.command_chain or ()
    command = " ".join(("modelgap", *chain))
    if isinstance(error, MissingArgumentError) and error.argument and chain:
        return f"{_missing(error)} See {command} --help."
    if not isinstance(error, UnusedCliTokensError):
        return f"{' '.join(str(error).split())} See {command} --help."
    words = error.unused_tokens or [""]
    options = () if error.app is None else error.app.assemble_argument_collection()
    takes = any("--robot" in option.names for option in options)
    meant = f" For one robot: {command} --robot {words[0]}." if takes else ""
    return (
        f"'{' '.join(words)}' has no place here, expected options after "
        f"{command}.{meant} See {command} --help."
    )


def _missing(error: MissingArgumentError) -> str:
    """Return which option lacks its value, or which word or option is not there."""
    name, kind = error.argument.name, error.argument.field_info.kind
    shown = f"{name} {error.argument.parameter.metavar or 'WORD'}"
    if error.keyword is not None:
        return f"{name} has nothing behind it, expected {shown}."
    if kind is not kind.KEYWORD_ONLY:  # it has its place on the line
        shown = name.lstrip("-").upper()
    return f"{' '.join(error.command_chain)} needs {shown}, which is missing."


def _say(text: str, code: int) -> int:
    # What came out of a stranger's file must do nothing to the terminal.
    short = _WORD.sub(lambda word: shortened(word[0]), text)
    print(f"modelgap: {plain(short)}", file=sys.stderr)
    return code
