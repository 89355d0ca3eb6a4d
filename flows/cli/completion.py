"""The scripts that complete words of a command line in bash, zsh and fish.

Cyclopts, which installs them, writes scripts without files, ids of a store and commands
that its help does not list. These ask one function of the POSIX shell for all three.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from cyclopts import App
from cyclopts.completion.detect import detect_shell
from cyclopts.completion.install import create_install_completion_command

from flows.cli import app

# Which ids of a store stand for an argument: of commands, then of options.
_ALL = "run model diagnosis validation report"
_IDS = {
    **dict.fromkeys(("show", "diff", "lineage", "rerun"), _ALL),
    **dict.fromkeys(("adopt", "next"), "diagnosis"),
    **dict.fromkeys(("export", "monitor"), "run model diagnosis"),
    **dict.fromkeys(("diagnose", "check", "identify", "calibrate"), "run"),
    **dict.fromkeys(("predict", "validate", "quarantine"), "run"),
}
_OPTION_IDS = {"--baseline": "run", "--holdout": "run", "--model": "model diagnosis"}


def format_completion(app: App, shell: str) -> str:
    """Return the script that completes the words of a program in a shell."""
    from flows.steps.export import list_export_targets
    from residual.robot.robot import list_built_in_robots

    words = {"--robot": list_built_in_robots(), "--to": list_export_targets()}
    commands, choices, groups, valued = [], [], [], {}
    for path, each in _walk(app, ()):
        inner = [name for name in each if not name.startswith("-")]
        options = [name for name in each if name.startswith("--")]
        command = " ".join(path)
        groups += [f"'{command}'"] if inner and path else []
        for argument in () if inner else each.assemble_argument_collection():
            names = [name for name in argument.names if name.startswith("--")]
            if argument.index is None:
                options += names[:1]  # the others are those of older versions
            if names and argument.token_count()[0]:
                valued |= dict.fromkeys(names)
                offered = " ".join(words.get(names[0], argument.get_choices() or ()))
                if offered or names[0] in _OPTION_IDS:
                    ids = _OPTION_IDS.get(names[0], "")
                    case = f"'{command} {names[0]}'"
                    choices.append(f"  {case}) names='{offered}' ids='{ids}' ;;")
        ids = "" if inner else _IDS.get(path[-1], "")
        commands.append(
            f"  '{command}') flags='{' '.join(dict.fromkeys(options))}' "
            f"names='{' '.join(inner)}' ids='{ids}' files={int(bool(inner))} ;;"
        )
    parts = {"GROUPS": " | ".join(groups), "VALUES": " | ".join(valued)}
    parts |= {"COMMANDS": "\n".join(commands), "CHOICES": "\n".join(choices)}
    offer = _fill("completion.sh", parts)
    quoted = offer.replace("\\", r"\\").replace("'", r"\'")
    return _fill(f"completion.{shell}", {"OFFER": offer, "QUOTED": quoted})


def _fill(file: str, parts: Mapping[str, str]) -> str:
    text = Path(__file__).with_name(file).read_text(encoding="utf-8")
    return re.sub("@([A-Z]+)@", lambda word: parts[word[1]], text)


def _walk(app: App, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], App]]:
    """Every command with the words that name it, groups before what is in them."""
    yield path, app
    for name in app:
        if not name.startswith("-"):
            yield from _walk(app[name], (*path, name))


def _install(*, shell: str | None = None, **places: Any) -> Path:
    """Install the completion of a shell where Cyclopts installs its own."""
    shell = shell or detect_shell()
    path = app.install_completion(shell=shell, **places)
    path.write_text(format_completion(app, shell), encoding="utf-8")
    return path


install_completion = create_install_completion_command(_install, add_to_startup=True)
