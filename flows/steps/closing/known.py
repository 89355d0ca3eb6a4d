"""What a loop knows by what it has done: its records, read once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from warehouse.numbered import Decision

RUN = "run"


@dataclass(frozen=True, eq=False, slots=True)
class Known:
    """The records of a loop, sorted.

    Attributes:
        last: The last one, None at the beginning.
        runs: Every experiment, the first one first.
        adopted: What the last adoption left (`diagnosis`, `effects`), None for none.
        since: Ids of the experiments to fit that came after it.
        later: The experiments after it.
        looks: What every diagnosis after it said.
    """

    last: Decision | None
    runs: tuple[Decision, ...]
    adopted: Mapping | None
    since: tuple[str, ...]
    later: tuple[Decision, ...]
    looks: tuple[Mapping, ...]

    @classmethod
    def of(cls, history: Sequence[Decision]) -> "Known":
        """Sort the records of a loop."""
        runs = tuple(d for d in history if d.action == RUN)
        given = [d for d in history if d.action == "adopt" and d.result["adopted"]]
        begun = given[-1].number if given else 0
        later = tuple(d for d in runs if d.number > begun)
        return cls(
            last=history[-1] if history else None,
            runs=runs,
            adopted=given[-1].result if given else None,
            since=_fitted(later),
            later=later,
            looks=tuple(
                d.result for d in history if d.action == "diagnose" and d.number > begun
            ),
        )

    @property
    def fit(self) -> tuple[str, ...]:
        """Ids of all experiments to fit."""
        return _fitted(self.runs)

    @property
    def held_out(self) -> tuple[str, ...]:
        """Ids of those that no fit sees."""
        return tuple(d.made for d in self.runs if d.result["role"] != "fit")

    @property
    def standard(self) -> int:
        """How many of the standard motions to fit were run."""
        own = (d for d in self.runs if d.result["role"] == "fit")
        return sum(not d.result["designed"] for d in own)

    def tried(self, rivals: Sequence[str]) -> int:
        """How many experiments since the last adoption were for these rivals."""
        wanted = sorted(rivals)
        return sum(sorted(d.result["rivals"]) == wanted for d in self.later)


def _fitted(runs: Sequence[Decision]) -> tuple[str, ...]:
    return tuple(d.made for d in runs if d.result["role"] == "fit")
