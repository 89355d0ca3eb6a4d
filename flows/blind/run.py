"""A whole blind study over all cores: what is stored is not done again.

First an arm with nothing to hide in every excitation, which says how small an effect
would still be seen there; then the cases, whose sizes are told in that unit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from flows.blind import steps
from flows.blind.draw import Asked, Excitation, drafts
from flows.blind.sums import summary
from flows.outputs import Progress
from flows.settings import cores
from flows.storage.diagnosis import read_verdict
from flows.workers.pool import Pool, Runs, outcomes
from residual.diagnosis.result import Detectable
from residual.errors import RunError
from sim.engine.records import CLEAN, BackgroundWord
from warehouse.commit import commit_record
from warehouse.layout import read_record


@dataclass(frozen=True, slots=True)
class Study:
    """What a study left in the store.

    Attributes:
        id: Id of its own validation.
        rows: One per case, as in the view ``blind``, with ``validation_id``.
        summary: Its figures.
        known: How many cases were in the store already.
        failed: What did not come to its end, in words.
    """

    id: str
    rows: tuple[Mapping, ...]
    summary: Mapping
    known: int
    failed: tuple[str, ...]


def run_study(
    asked: Asked,
    store: Path,
    tell: Progress | None = None,
    pool: Runs | None = None,
    workers: int | None = None,
) -> Study:
    """Run what is not in the store, and conclude."""
    if pool is None:
        with Pool(workers or cores()) as own:
            return run_study(asked, store, tell, own)
    minima, lost = run_nulls(asked, store, tell, pool)
    done, known, failed = run_cases(asked, store, minima, tell, pool)
    return conclude(asked, store, done, known, [*lost, *failed])


def run_nulls(
    asked: Asked, store: Path, tell: Progress | None, pool: Runs
) -> tuple[dict[int, Sequence[Detectable]], list[str]]:
    """Return the minimum detectable sizes of every excitation, by its number.

    Returns:
        The sizes, and what failed: without sizes an excitation has no cases.
    """
    return null_sizes([(asked, e) for e in _excitations(asked)], store, tell, pool)


def null_sizes(
    wanted: Sequence[tuple[Asked, Excitation]],
    store: Path,
    tell: Progress | None,
    pool: Runs,
) -> tuple[dict[int, Sequence[Detectable]], list[str]]:
    """Return the minimum detectable sizes of some excitations, each of a study."""
    keys = {e.index: steps.key_of(steps.null_specs(own, e)) for own, e in wanted}
    ids = steps.finished(store, steps.NULL)
    todo = [(own, e) for own, e in wanted if keys[e.index] not in ids]
    jobs = [partial(steps.run_null, own, e, keys[e.index], store) for own, e in todo]
    failed = []
    for count, (at, value, why) in enumerate(outcomes(jobs, pool), start=1):
        number = todo[at][1].index
        if value is None:
            failed.append(f"excitation {number} and its cases: {why}")
        else:
            ids[keys[number]] = value
        if tell:
            tell(f"excitation {count} of {len(todo)}", count / len(todo))
    minima = {
        number: read_verdict(store, ids[key]).minimum_detectable
        for number, key in keys.items()
        if key in ids
    }
    return minima, failed


def run_cases(
    asked: Asked,
    store: Path,
    minima: Mapping[int, Sequence[Detectable]],
    tell: Progress | None,
    pool: Runs,
) -> tuple[list[str], int, list[str]]:
    """Run the cases that are not in the store.

    Returns:
        Ids of their validations in order, how many were known, and what failed.
    """
    cases = [
        steps.make_case(asked, draft, minima[draft.excitation.index])
        for draft in drafts(asked)
        if draft.excitation.index in minima
    ]
    ids = steps.finished(store, steps.CASE)
    todo = [case for case in cases if case.key not in ids]
    failed = []
    jobs = [partial(steps.run_case, asked, case, store) for case in todo]
    for count, (at, value, why) in enumerate(outcomes(jobs, pool), start=1):
        number = todo[at].draft.index
        if value is None:
            failed.append(f"case {number}: {why}")
        else:
            ids[todo[at].key] = value
        if tell:
            word = "failed" if value is None else "judged"
            share = (count + len(cases) - len(todo)) / len(cases)
            tell(f"case {number} {word}, {count} of {len(todo)}", share)
    done = [ids[case.key] for case in cases if case.key in ids]
    return done, len(cases) - len(todo), failed


def conclude(
    asked: Asked, store: Path, done: Sequence[str], known: int, failed: Sequence[str]
) -> Study:
    """Sum up the cases and store that.

    Args:
        done: Ids of the validations of its cases, in order.
    """
    if not done:
        raise RunError(f"No case came to its end: {failed[0] if failed else 'none'}")
    cases = {id: read_record(store, id) for id in done}
    rows = [{"validation_id": id, **case["row"]} for id, case in cases.items()]
    figures = summary(rows)
    record = {
        "robot": asked.robot,
        "kind": steps.STUDY,
        "key": f"{asked.seed}/{asked.n}{_of(asked.background)}",
        "seed": asked.seed,
        "n": asked.n,
        "duration": asked.duration,
        "background": asked.background,
        "summary": figures,
        # Cases of earlier versions have no edit test.
        "edits": [edit for case in cases.values() for edit in case.get("edits", ())],
        "failed": list(failed),
    }
    parents = {"case": list(done)}
    id = commit_record(store, "validations", record, None, parents)
    return Study(id, tuple(rows), figures, known, tuple(failed))


def _of(background: BackgroundWord) -> str:
    """Return what tells a study from one of clean arms, as they all were once."""
    return "" if background == CLEAN else f"/{background}"


def _excitations(asked: Asked) -> list[Excitation]:
    unique = {d.excitation.index: d.excitation for d in drafts(asked)}
    return list(unique.values())
