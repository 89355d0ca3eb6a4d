"""A campaign whose workers share only a store on object storage."""

from flows.settings import resolve_store_folder
from flows.specs import parse_spec
from flows.steps import experiment as campaign
from flows.steps.experiment import plan_experiments, run_campaign_experiments
from flows.workers import InlineExecutor
from tests.warehouse import store_samples as samples
from warehouse import remote_store


def test_a_campaign_gives_its_workers_the_name_of_the_store(bucket_store, monkeypatch, tmp_path):
    store = resolve_store_folder(bucket_store)
    given = []

    class Elsewhere(InlineExecutor):
        def submit(self, work, *words):
            given.append(words[0].keywords["store"])
            monkeypatch.setenv(remote_store.CACHE, str(tmp_path / "another machine"))
            remote_store.close_buckets()
            return super().submit(work, *words)

    def run(spec, place, *_):
        assert place.parent == tmp_path / "another machine"
        return samples.commit(place, spec.seed)

    monkeypatch.setattr(campaign, "simulate_and_store", run)
    specs = [("one", parse_spec({"seed": 1}, "S"))]
    summary = run_campaign_experiments(plan_experiments(specs, store), store, executor=Elsewhere())
    assert given == [bucket_store]
    # It came back, though as another run than that of the spec.
    assert "the code was changed" in next(iter(summary.failed.values()))
