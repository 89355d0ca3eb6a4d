"""All commands by name and group. Each is loaded only when it runs.

Only here, and for optional extras, is anything loaded late: `modelgap --help` loads no
numerics, and a command loads what it needs and no more.
"""

import ast
import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from cyclopts import App, Group

from residual.lazy import Lazy

origin = Lazy("warehouse.provenance")

_HELP = """Find what a robot's dynamic model is missing.

The missing effect is named, added to the model, and proved on motion that was
not fitted. Start with one of these:

 modelgap demo
 modelgap diagnose A.csv B.csv --robot arm.urdf --holdout C.csv

The first makes an arm with an effect that its model does not have; the second
takes your own logs. 'modelgap COMMAND --help' explains a command.

Exit codes: 0 done, whatever the verdict; 1 the run failed; 2 bad usage or
input; 130 interrupted.
"""

_LOGS = "LOG... --robot ROBOT"
# By group: a command is a function of that name in `flows.cli`, as MODULE:FUNCTION,
# and what its usage line says where that is not plain.
_COMMANDS = {
    "First steps": {
        "demo": ("demo:demo", None),
        "diagnose": ("diagnose:diagnose", _LOGS),
        "next": ("next:next_", "VERDICT.json|ID [LOG...]"),
        "explain": ("explain:explain", "[WORD...]"),
    },
    "Your logs": {
        "check": ("logs:check", _LOGS),
        "map": ("logs:map_", "LOG --robot ROBOT [--out COLUMNS.toml]"),
        "import": ("logs:import_", _LOGS),
        "identify": ("fit:identify", _LOGS),
        "calibrate": ("fit:calibrate", _LOGS),
        "calibrate-null": ("fit:calibrate_null", _LOGS),
        "validate": ("experiment:validate", None),
        "monitor": ("watch:monitor", "MODEL RUN..."),
        "watch": ("watch:watch", "ROBOT --file FILE|-"),
        "predict": ("models:predict", "LOG... --model MODEL"),
        "view": ("models:view", "RUN|LOG [--robot ROBOT] [--verdict ID]"),
        "export": ("models:export", "MODEL --to TARGET --out DIR"),
    },
    "Your experiments": {
        "trajectory": ("experiment:trajectory", None),
        "experiment": ("experiment:experiment", None),
        "campaign": ("experiment:campaign", None),
        "fleet": ("experiment:fleet", "CAMPAIGN.toml|RUN,RUN ..."),
        "blind": ("demo:blind", None),
    },
    "Your robot's model": {
        "models": ("models:models", None),
        "adopt": ("models:adopt", None),
        "rollback": ("models:rollback", None),
        "close": ("close:close", None),
        "wear": ("watch:wear", "[RUN...] --robot ROBOT"),
    },
    "History": {
        "runs": ("store:runs", None),
        "show": ("store:show", None),
        "sql": ("sql:sql", None),
        "diff": ("history:diff", None),
        "lineage": ("history:lineage", None),
        "rerun": ("history:rerun", None),
        "bundle": ("history:bundle", None),
        "unbundle": ("history:unbundle", None),
        "pages": ("service:pages", None),
        "compact": ("store:compact", None),
        "verify": ("store:verify", None),
        "prune": ("store:prune", None),
        "quarantine": ("store:quarantine", "RUN --reason TEXT"),
    },
    "Schedule": {
        "init": ("project:init", "[DIR]"),
        "inbox": ("project:inbox", None),
        "up": ("service:up", None),
        "status": ("service:status", None),
        "down": ("service:down", None),
    },
}


app = App(
    name="modelgap",
    help=_HELP,
    help_format="plaintext",  # what draws Markdown is a slow import
    version=lambda: origin.version_text(),
    suppress_keyboard_interrupt=False,
)
for flag in ("--help", "--version"):
    app[flag].group = "Options"


def _described(place: str) -> str:
    """Return what a command says of itself, without loading what it needs.

    Args:
        place: The command as MODULE:FUNCTION.
    """
    module, _, name = place.partition(":")
    source = Path(find_spec(f"flows.cli.{module}").origin).read_text(encoding="utf-8")
    (command,) = (
        node
        for node in ast.parse(source).body
        if isinstance(node, ast.FunctionDef) and node.name == name
    )
    return ast.get_docstring(command).partition("\n\nArgs:")[0]


def _register() -> None:
    for heading, commands in _COMMANDS.items():
        group = Group.create_ordered(heading)
        for number, (name, (place, usage)) in enumerate(commands.items()):
            app.command(
                f"flows.cli.{place}",
                name=name,
                group=group,
                sort_key=number,
                help=_described(place),
                help_format="markdown",
                usage=usage and f"Usage: modelgap {name} {usage} [OPTIONS]",
            )


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
    app(
        tied.split("\0") if tied else [],
        exit_on_error=False,
        print_error=False,
        result_action="return_value",
    )
