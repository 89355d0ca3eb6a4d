"""A campaign to be killed; importing it prepares all that is slow the first time."""

from tests.warehouse import store_samples as made
from warehouse.provenance import provenance

RUNS = 6

provenance()


def campaign(store, started=None):
    """Commit six runs and a diagnosis."""
    if started is not None:
        started.set()
    runs = [made.commit(store, seed) for seed in range(RUNS)]
    return made.store_verdict(store, made.verdict(runs[:1]), {"theta": [1.0]}, runs)
