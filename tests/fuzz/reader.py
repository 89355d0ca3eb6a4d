"""What is fuzzed: a reader, valid files of its kind, and what an answer must be."""

import json
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from traceback import extract_tb

from hypothesis.strategies import SearchStrategy

from residual.errors import ModelgapError

ROOT = Path(__file__).parents[2]
LONGEST = 20.0  # seconds for one small file, on a machine that does other work too
MEMORY = 1 << 30  # bytes that reading a small file may take
WORDS = 5_000  # characters of a message that somebody can still read


@dataclass(frozen=True, slots=True)
class Reader:
    """One reader of the product."""

    name: str  # what it reads; also its folder of the corpus
    # Gives the strategy of its inputs; called once, before the first.
    inputs: Callable[[], SearchStrategy[bytes]]
    seeds: Callable[[], list[bytes]]  # gives valid inputs
    # Reads an input, with a folder that is empty before; fails an assertion where the
    # answer is wrong.
    read: Callable[[bytes, Path], None]


@dataclass(frozen=True, eq=False, slots=True)
class Finding:
    """Something else than a right answer or a clear error."""

    name: str  # kind and place of it, as its file in the corpus is called
    error: BaseException  # what was raised

    def __str__(self) -> str:
        return f"{self.name}: {' '.join(str(self.error).split())[:150]}"


class LateError(BaseException):
    """Reading took too long; not an Exception, so that no reader catches it."""


class LargeError(Exception):
    """Reading took too much memory."""


def judge(reader: Reader, data: bytes, place: Path) -> Finding | None:
    try:
        with _in_time(LONGEST), _in_memory(MEMORY), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read(data, place)
    except ModelgapError as error:
        if 0 < len(str(error)) <= WORDS:
            return None
        return Finding(f"message-of-{len(str(error))}-characters", error)
    except (Exception, LateError) as error:
        return Finding(_name(error), error)
    return None


def _name(error: BaseException) -> str:
    ours = [f for f in extract_tb(error.__traceback__) if _is_ours(f.filename)]
    where = f"{Path(ours[-1].filename).stem}-{ours[-1].name.strip('<>')}" if ours else ""
    return f"{type(error).__name__}-{where}".lower()


def _is_ours(file: str) -> bool:
    path = Path(file)
    inside = path.is_relative_to(ROOT) and ".venv" not in path.parts
    return inside and path.name != "reader.py"


@contextmanager
def _in_time(seconds: float) -> Iterator[None]:
    def stop(*_: object) -> None:
        raise LateError(f"took longer than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def _in_memory(most: int) -> Iterator[None]:
    own = Path("/proc/self")
    (own / "clear_refs").write_text("5")  # the peak is counted anew
    before = _peak(own)
    try:
        yield
    finally:
        used = _peak(own) - before
    if used > most:
        raise LargeError(f"took {used} bytes")


def _peak(own: Path) -> int:
    lines = (own / "status").read_text().splitlines()
    return 1024 * int(next(x for x in lines if x.startswith("VmHWM")).split()[1])


def same_json(one: object, two: object) -> bool:
    """Whether two values are the same text of JSON."""
    return json.dumps(one, sort_keys=True) == json.dumps(two, sort_keys=True)
