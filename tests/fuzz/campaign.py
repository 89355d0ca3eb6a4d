"""Minutes of fuzzing of one reader, in a process that may hang or die."""

import multiprocessing
import re
import shutil
import tempfile
from collections.abc import Callable
from hashlib import sha256
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic

from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings

from tests.fuzz.reader import LONGEST, Finding, Reader, judge

CORPUS = Path(__file__).parent / "corpus"
BATCH = 400  # examples per seed of hypothesis
SHRINKING = 40.0  # seconds beyond the budget in which a finding is made smaller


def fuzz(
    reader: Reader, seconds: float, first: int, corpus: Path = CORPUS
) -> tuple[int, list[str]]:
    """Fuzz a reader; every finding becomes a small file of the corpus.

    Returns the number of examples and the findings, a line each.
    """
    end, examples, findings = monotonic() + seconds, 0, []
    with tempfile.TemporaryDirectory(prefix="modelgap-fuzz-") as name:
        place, died = Path(name), "never started"
        while died and monotonic() < end:
            context = multiprocessing.get_context("fork")
            mine, theirs = context.Pipe(duplex=False)
            arguments = (reader, end, first + examples, place, corpus, theirs)
            process = context.Process(target=_work, args=arguments)
            process.start()
            theirs.close()
            died = "hang"
            try:
                # A message per example: silence is a hang that no alarm could end.
                while mine.poll(3 * LONGEST + (0 if examples else 120)):
                    message = mine.recv()
                    if message is None:
                        died = ""
                        break
                    if isinstance(message, Exception):
                        raise message  # of the fuzzing itself
                    examples += isinstance(message, int)
                    findings += [message] if isinstance(message, str) else []
            except EOFError:
                died = "killed"
            process.kill()
            process.join()
            if died:
                _save(corpus / reader.name, died, (place / "now").read_bytes())
                findings.append(died)
    return examples, findings


def _work(
    reader: Reader, end: float, number: int, place: Path, corpus: Path, out: Connection
) -> None:
    known: set[str] = set()
    try:
        for data in reader.seeds():  # what is compiled or loaded once is of no example
            reader.read(data, _empty(place))
        while monotonic() < end:
            finding = _batch(reader, number, place, end, known, lambda: out.send(1))
            number += 1
            if finding:
                known.add(finding[0].name)
                _save(corpus / reader.name, finding[0].name, finding[1])
                out.send(str(finding[0]))
        out.send(None)
    except Exception as error:
        out.send(RuntimeError(f"{reader.name}: {error!r:.500}"))


def _batch(
    reader: Reader, number: int, place: Path, end: float, known: set[str], count: Callable[[], None]
) -> tuple[Finding, bytes] | None:
    """Return the first new finding of one seed, made as small as time allows."""
    smallest: list[tuple[Finding, bytes]] = []

    @seed(number)
    @settings(
        max_examples=BATCH,
        deadline=None,
        database=None,
        derandomize=False,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
        print_blob=False,
        verbosity=Verbosity.quiet,
    )
    @given(reader.inputs())
    def one(data: bytes) -> None:
        if monotonic() > end + (SHRINKING if smallest else 0):
            return
        (place / "now").write_bytes(data)
        count()
        judgment = judge(reader, data, _empty(place))
        if judgment is None or judgment.name in known:
            return
        if smallest and smallest[0][0].name != judgment.name:
            return
        if not smallest or len(data) <= len(smallest[0][1]):
            smallest[:] = [(judgment, data)]
        raise judgment.error

    try:
        one()
    except BaseException:
        if not smallest:
            raise
    return smallest[0] if smallest else None


def _empty(place: Path) -> Path:
    inside = place / "here"
    shutil.rmtree(inside, ignore_errors=True)
    inside.mkdir()
    return inside


def _save(folder: Path, name: str, data: bytes) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    plain = re.sub(r"[^a-z0-9_-]+", "", name.lower())[:60]
    (folder / f"{plain}-{sha256(data).hexdigest()[:6]}.bin").write_bytes(data)
