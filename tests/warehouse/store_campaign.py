"""A campaign to be killed; importing it prepares all that is slow the first time."""

from tests.warehouse import store_samples as samples
from warehouse.code_provenance import read_code_provenance

RUNS = 6

read_code_provenance()


def campaign(store, started=None):
    if started is not None:
        started.set()
    runs = [samples.commit(store, seed) for seed in range(RUNS)]
    return samples.store_verdict(store, samples.verdict(runs[:1]), {"theta": [1.0]}, runs)
