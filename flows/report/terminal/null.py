"""A calibrated null in the terminal."""

from pathlib import Path

from flows.steps.null import Made
from residual.evidence.rules import Rules
from warehouse.objects.mirror import shown


def null_lines(made: Made, draws: int, store: Path) -> list[str]:
    """Return what a null says, a sentence each."""
    null = made.null
    least = Rules().threshold
    threshold, beyond = null.threshold(least), null.beyond(null.threshold(least))
    chance = f"{100 * beyond:.2g} %" if beyond > 1e-4 else "less than 0.01 %"
    lines = [
        null.sentence(least),
        f"an exponential tail, fitted to the largest fifth, has {chance} of such "
        f"recordings reach {threshold:.1f} nats: an extrapolation",
        f"draws: {len(null.net)} in {len(set(null.block))} recordings of encoder noise "
        f"(worth {null.independent:.0f} independent ones), {made.known} known "
        "before",
        f"stored in {shown(store)}: modelgap show {null.id}",
    ]
    if not made.complete:
        lines.append(
            f"interrupted: {len(null.net)} of {draws} draws are kept; the same command "
            "goes on"
        )
    return lines
