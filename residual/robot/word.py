"""One word for a robot file and how it is read, which requests and records keep."""

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import parse_qsl, urlencode

_OPTIONS = ("chain", "tip", "arg", "package")


def word_of(
    robot: str | Path,
    chain: Sequence[str] = (),
    tip: str | None = None,
    args: Sequence[str] = (),
    packages: Sequence[str] = (),
) -> str:
    """Return one word for a robot file and how it is read: "arm.urdf#tip=flange".

    Args:
        chain: Names of the joints of the arm.
        tip: The link that the arm ends with.
        args: Arguments of a xacro, as "name:=value".
        packages: Folders where its packages are looked for.
    """
    pairs = [("chain", ",".join(chain)), ("tip", tip or "")]
    pairs += [("arg", word) for word in args] + [("package", p) for p in packages]
    options = urlencode([(key, value) for key, value in pairs if value], safe=",:=/")
    return f"{robot}#{options}" if options else str(robot)


def split_word(spec: str | Path) -> tuple[str, dict[str, list[str]]]:
    """Return the file of a word for a robot, and how it is read, by option."""
    word, out = str(spec), dict[str, list[str]]()
    place, sign, text = word.rpartition("#")
    options = parse_qsl(text)
    if not sign or not options or any(key not in _OPTIONS for key, _ in options):
        return word, out
    for key, value in options:
        out.setdefault(key, []).append(value)
    return place, out
