"""A folder that fills: its files in the order of their names, the last as it grows."""

import time
from dataclasses import dataclass
from pathlib import Path

from flows.inputs.stream.file import GrowingFile
from flows.inputs.stream.source import POLL, Batch, Meaning
from residual.errors import InputError

_TEXT = (".csv", ".txt", ".jsonl")


@dataclass(slots=True)
class FillingFolder:
    """A folder into which somebody puts files.

    Attributes:
        folder: The folder.
        meaning: What the lines of its files are.
        current: The file that is read, None before the first.
        idle: Looks in a row at which it had nothing new.
        late: Names that came behind their place, and were said to.
    """

    folder: Path
    meaning: Meaning
    current: GrowingFile | None = None
    idle: int = 0
    late: frozenset[str] = frozenset()

    @classmethod
    def at(
        cls, folder: Path, meaning: Meaning, position: dict | None
    ) -> "FillingFolder":
        """Return the folder, at the place where it was left; None for its first file.

        Raises:
            InputError: If there is no such folder.
        """
        if not folder.is_dir():
            raise InputError(f"There is no folder {folder}. Make it, or name another.")
        if not position:
            return cls(folder, meaning)
        path = folder / position["file"]
        late = frozenset(position.get("seen", ()))
        return cls(folder, meaning, GrowingFile.at(path, meaning, position), 0, late)

    @property
    def name(self) -> str:
        """Its name."""
        return self.folder.name

    def position(self) -> dict:
        """Return where to go on."""
        if self.current is None:
            return {}
        return self.current.position() | {"seen": sorted(self.late)}

    def read(self) -> Batch:
        """Return what has come in the file that is read; at its end, take the next."""
        names = sorted(
            p.name for p in self.folder.iterdir() if p.suffix.lower() in _TEXT
        )
        notes = self._behind(names)
        if self.current is None:
            if not names:
                return Batch()
            self._open(names[0])
        assert self.current is not None
        batch = self.current.read()
        if batch.samples is not None:
            self.idle = 0
            return Batch(batch.samples, (*notes, *batch.notes), batch.more)
        self.idle += 1
        following = [name for name in names if name > self.current.name]
        # Twice, since its last line may be written after the next file was begun.
        if following and self.idle > 1:
            if self.current.unfinished():
                notes += (f"{self.current.name}: its last line has no end, left out",)
            self._open(following[0])
            notes += (f"{following[0]}: read from now on",)
        return Batch(None, (*notes, *batch.notes), bool(following))

    def unfinished(self) -> bool:
        """Whether a last line has no end yet."""
        return self.current is not None and self.current.unfinished()

    def wait(self) -> None:
        """Wait a moment."""
        time.sleep(POLL)

    def close(self) -> None:
        """Nothing is held."""

    def _open(self, name: str) -> None:
        before = {self.current.name} if self.current else set()
        self.late |= before
        self.current = GrowingFile(self.folder / name, self.meaning)
        self.idle = 0

    def _behind(self, names: list[str]) -> tuple[str, ...]:
        """Say which files came too late to be read in their order."""
        if self.current is None:
            return ()
        new = {n for n in names if n < self.current.name} - self.late
        self.late |= new
        return tuple(
            f"{name} sorts before {self.current.name}, which is read: left out"
            for name in sorted(new)
        )
