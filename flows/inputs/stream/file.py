"""A file that grows: its new lines, as soon as they have an end."""

import hashlib
import time
from dataclasses import dataclass, field
from pathlib import Path

from flows.inputs.stream.lines import Reader
from flows.inputs.stream.source import POLL, Batch, Meaning, whole_lines
from residual.errors import InputError

_AT_ONCE = 1 << 20  # bytes
_FIRST = 256  # bytes by which a file is known again


@dataclass(slots=True)
class GrowingFile:
    """A text file that somebody writes.

    Attributes:
        path: The file; it need not be there yet.
        meaning: What its lines are.
        offset: Bytes that were read.
        header: Its line of names, None before it was read.
        known: Hash of its first bytes, and how many they are.
    """

    path: Path
    meaning: Meaning
    offset: int = 0
    header: str | None = None
    known: tuple[str, int] = ("", 0)
    _reader: Reader | None = field(default=None, repr=False)

    @classmethod
    def at(cls, path: Path, meaning: Meaning, position: dict | None) -> "GrowingFile":
        """Return the file, at the place where it was left; None for its begin.

        Raises:
            InputError: If it is a folder.
        """
        if path.is_dir():
            raise InputError(f"{path} is a folder, expected a file. Use --folder.")
        if not position or position.get("file") != path.name:
            return cls(path, meaning)
        known = (position["known"][0], position["known"][1])
        return cls(path, meaning, position["read"], position["header"], known)

    @property
    def name(self) -> str:
        """Its name."""
        return self.path.name

    def position(self) -> dict:
        """Return where to go on."""
        place = {"file": self.path.name, "read": self.offset}
        return place | {"header": self.header, "known": list(self.known)}

    def read(self) -> Batch:
        """Return the lines that were completed since the last look."""
        try:
            with self.path.open("rb") as file:
                note = self._anew(file)
                file.seek(self.offset)
                text = file.read(_AT_ONCE)
                self._remember(file)
        except FileNotFoundError:
            return Batch()
        except OSError as error:
            raise InputError(f"Cannot read {self.path}: {error.strerror}.") from error
        lines, used = whole_lines(text)
        if not used and len(text) == _AT_ONCE:
            raise InputError(f"{self.name}: a line of more than {_AT_ONCE} bytes.")
        self.offset += used
        lines = self._without_names(lines)
        if not lines or self._reader is None:
            return Batch(notes=note)
        return Batch(self._reader.samples(lines), note, len(text) == _AT_ONCE)

    def unfinished(self) -> bool:
        """Whether a last line has no end yet."""
        try:
            return self.path.stat().st_size > self.offset
        except OSError:
            return False

    def wait(self) -> None:
        """Wait a moment."""
        time.sleep(POLL)

    def close(self) -> None:
        """Nothing is held."""

    def _without_names(self, lines: list[str]) -> list[str]:
        if self.header is None and lines:
            first = lines[0]
            self.header = first
            # The first JSON object has names and values.
            lines = lines if first.lstrip().startswith("{") else lines[1:]
        if self._reader is None and self.header is not None:
            self._reader = self.meaning.reader(self.header, self.name)
        return lines

    def _anew(self, file) -> tuple[str, ...]:
        """Begin again where the file is another one, or shorter; say so."""
        size = file.seek(0, 2)
        same = size >= self.offset and _hash(file, self.known[1]) == self.known[0]
        if same or not self.offset:
            return ()
        how = "shorter than what was read of it" if size < self.offset else "another"
        self.offset, self.header, self._reader, self.known = 0, None, None, ("", 0)
        return (f"{self.name} is {how}: it was replaced, and is read from its begin",)

    def _remember(self, file) -> None:
        if self.known[1] < _FIRST:
            size = min(file.seek(0, 2), _FIRST)
            self.known = (_hash(file, size), size)


def _hash(file, size: int) -> str:
    if not size:
        return ""
    file.seek(0)
    return hashlib.sha256(file.read(size)).hexdigest()[:16]
