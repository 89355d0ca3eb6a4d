"""Ids of runs move for nobody: those of specs are as ab4d41df computed them."""

import json
import re
from pathlib import Path

import pytest

from flows.specs import load_campaign, load_spec
from flows.steps import demo, experiment
from tests.checkout import ROOT

IDS = json.loads(Path(__file__).with_name("run_ids.json").read_text())


def read_tables(page: str) -> list[str]:
    text = (ROOT / "docs" / page).read_text("utf-8")
    return re.findall(r"```toml[^\n]*\n(.*?)```", text, re.DOTALL)


@pytest.fixture
def specs(tmp_path):
    tables = read_tables("experiments.md")
    spec = next(t for t in tables if t.startswith("schema = 1"))
    axes = {t[1:5]: t for t in tables if t.startswith(("[grid]", "[random]"))}
    (guide,) = (t for t in read_tables("guide/first_hour.md") if "[grid]" in t)
    texts = {"spec": spec, "guide": guide}
    texts |= {name: spec + table for name, table in axes.items()}
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text)
    out = {"spec": load_spec(tmp_path / "spec.toml")}
    shown = demo.build_demo_specs(7)
    out |= {f"demo {i}": shown[i][1] for i in (0, 3, 7)}
    paths = [tmp_path / f"{name}.toml" for name in ("guide", *axes)]
    for path in (*paths, *sorted((ROOT / "examples").glob("*.toml"))):
        some = load_campaign(path)[:4]
        out |= {f"{path.stem} {i}": entry.spec for i, entry in enumerate(some)}
    return out


def test_the_ids_of_specs_are_those_that_they_always_had(specs, monkeypatch):
    monkeypatch.setattr(experiment, "hash_plant_code", lambda: "0" * 64)
    ids = {name: experiment.compute_run_id(spec) for name, spec in specs.items()}
    assert len(set(ids.values())) >= 20
    assert ids == IDS
