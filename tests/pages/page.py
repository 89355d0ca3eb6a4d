"""Pages that are run: files, commands and cells, in their order, in an empty folder.

In a page ```toml title="NAME" is a file, ```console holds commands behind "$ " with
lines of their output, ```python is a cell. What else is fenced is only shown.
"""

import re
import shlex
from pathlib import Path

from flows.cli import main

ROOT = Path(__file__).parents[2]
_BLOCK = re.compile(r'^```(console|python|toml title="([^"]+)")\n(.*?)^```$', re.M | re.S)
_ID = re.compile(r"[0-9a-f]{8,20}")


def run(page: str, folder: Path, capsys) -> int:
    """Run a page in a folder, the working directory; return how many commands."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    known, ids, count = {}, {}, 0
    for kind, name, body in _BLOCK.findall(text):
        if name:
            (folder / name).write_text(body, encoding="utf-8")
        elif kind == "python":
            exec(compile(body, page, "exec"), known)
        else:
            count += _console(body, ids, capsys)
    return count


def _console(body: str, ids: dict[str, str], capsys) -> int:
    joined = re.sub(r" *\\\n *", " ", body)  # a command may go on in the next line
    commands = re.split(r"^\$ ", joined, flags=re.M)[1:]
    for command in commands:
        line, *shown = command.splitlines()
        words = shlex.split(_now(line.partition("  #")[0], ids))
        assert words[0] == "modelgap", line
        code = main(words[1:])
        out, err = capsys.readouterr()
        assert code == 0, f"{line}\n{err}"
        _compare(line, shown, " ".join((out + err).split()), ids)
    return len(commands)


def _now(line: str, ids: dict[str, str]) -> str:
    """The command with the ids of today for those that the page shows."""
    for shown, real in ids.items():
        line = re.sub(rf"\b{shown[:4]}[0-9a-f]*\b", real, line)
    return line


def _compare(command: str, shown: list[str], printed: str, ids: dict[str, str]) -> None:
    """Every line that the page shows is printed, but for its numbers and ids."""
    for line in shown:
        words = line.split()
        match = re.search(r"\s+".join(map(_pattern, words)), printed)
        assert match, f"{command}\nprints no line like\n{line}\nbut\n{printed}"
        real = [word for word in match[0].split() if _ID.fullmatch(word)]
        ids.update(zip([w for w in words if _ID.fullmatch(w)], real, strict=False))


def _pattern(word: str) -> str:
    if _ID.fullmatch(word):
        return r"[0-9a-f]{8,20}"
    if word in ("…", "..."):
        return ".*?"
    return r"[-\d.]+".join(map(re.escape, re.split(r"-?\d[\d.]*", word)))
