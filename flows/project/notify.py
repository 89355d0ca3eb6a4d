"""Telling people of what happens: a program that is started, a line in a file.

The program is a list of arguments, never a line for a shell: what came out of a
stranger's log must start nothing.
"""

import json
import os
import re
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from flows.project.read import Project


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that people are told."""

    kind: str  # "alarm", "finding", "refused" or "failed"
    robot: str
    title: str  # in one line
    text: str = ""  # all of it
    ids: tuple[str, ...] = ()  # ids of the records that it is about
    page: str = ""  # the page to look at, "" for none


def tell(project: Project, notice: Notice) -> list[str]:
    """Tell people what the project's file says that they want to know.

    Returns:
        What went wrong in telling it, in words; a notice that does not arrive stops
        nothing.
    """
    wish, wrong = project.notify, []
    if notice.kind not in wish.on:
        return []
    about = {"at": datetime.now(UTC).isoformat(timespec="seconds")} | asdict(notice)
    line = json.dumps(about, ensure_ascii=False)
    if wish.file:
        try:
            place = project.path(wish.file)
            place.parent.mkdir(parents=True, exist_ok=True)
            with place.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
        except OSError as error:
            wrong.append(f"notify.file {wish.file}: {error.strerror}")
    if wish.command:
        wrong += _run(project, _filled(wish.command, notice), notice)
    return wrong


def _filled(command: Sequence[str], notice: Notice) -> list[str]:
    """Put values for {title} and so on into each argument; other braces stay."""
    values = {k: str(v) for k, v in asdict(notice).items() if k != "ids"}
    values["ids"] = " ".join(notice.ids)
    # In one pass: what a value says is never filled in again.
    return [
        re.sub(r"\{(\w+)\}", lambda found: values.get(found[1], found[0]), word)
        for word in command
    ]


def _run(project: Project, command: list[str], notice: Notice) -> list[str]:
    try:
        done = subprocess.run(
            command,
            cwd=project.folder,
            # Ours without the key of the server, which is nobody else's.
            env={k: v for k, v in os.environ.items() if not k.startswith("PREFECT")},
            input=f"{notice.title}\n\n{notice.text}\n",
            capture_output=True,
            text=True,
            timeout=project.notify.timeout,
            check=False,
        )
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        return [f"notify.command {command[0]}: {error}"]
    if done.returncode:
        output = " ".join(done.stderr.split())[:200]
        return [f"notify.command {command[0]} ended with {done.returncode}: {output}"]
    return []
