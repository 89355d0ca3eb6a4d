"""What a reader understood of one log, to be shown to the user."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Understood:
    """What was read, what was not, and what was converted.

    Attributes:
        id: Label of the recording.
        file: File as the user wrote it, without the window.
        window: Window as the user wrote it, None for the whole log.
        rows: Number of samples.
        rate: Mean sample rate [Hz].
        duration: From the first to the last sample [s].
        used: Columns read.
        ignored: Columns not read.
        conversions: Every change of unit, side, sign or zero, in words.
        warnings: What is odd but usable.
        notes: What was understood of the file beyond its columns.
        channels: Channel, column, unit and what else is done to it, one by one.
    """

    id: str
    file: str
    window: str | None
    rows: int
    rate: float
    duration: float
    used: tuple[str, ...]
    ignored: tuple[str, ...]
    conversions: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    channels: tuple[tuple[str, str, str, str], ...] = ()

    @property
    def text(self) -> str:
        """One line for the terminal."""
        size = f"{self.rows} samples, {self.rate:.4g} Hz, {self.duration:.4g} s"
        parts = [f"{self.id}: {size}", f"read {shorten(self.used)}"]
        if self.ignored:
            parts.append(f"ignored {shorten(self.ignored)}")
        parts += [*self.conversions, *self.notes]
        return "; ".join(parts)


def shorten(columns: Iterable[str]) -> str:
    """Return names in one line: q1 q2 q3 tau1 tau2 as "q1..3 tau1..2"."""
    words: list[str] = []
    for name in columns:
        stem, number = _split(name)
        if words and number is not None:
            # Goes on where the last word ended: q1..3 and q4 are q1..4.
            start, _, end = words[-1].partition("..")
            last_stem, first = _split(start)
            last = int(end) if end else first
            if last_stem == stem and last is not None and number == last + 1:
                words[-1] = f"{start}..{number}"
                continue
        words.append(name)
    return " ".join(words)


def _split(name: str) -> tuple[str, int | None]:
    stem = name.rstrip("0123456789")
    digits = name[len(stem) :]
    # A leading zero would be lost: "J01" stays as it is.
    if not digits or not stem or digits != str(int(digits)):
        return name, None
    return stem, int(digits)
