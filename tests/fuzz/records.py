"""Readers of JSON: models, verdicts; and the words for a part of a log."""

import json
from functools import cache
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from residual.errors import InputError
from residual.model.lookup import CorrectedModel
from residual.model.model import Model, Term
from residual.model.model_files import load_model, model_from_record
from residual.recording import Recording
from residual.robot.dynamics import read_inertial_parameters
from residual.verdict.document import from_json, parse_verdict, to_json
from tests.fuzz.arm import arm, as_csv, samples
from tests.fuzz.mutation import mutated, mutated_json
from tests.fuzz.reader import ROOT, Reader, same_json
from warehouse.logs import read_log


@cache
def _models() -> list[dict]:
    terms = [
        {"name": "viscous", "joints": [1], "shape": [], "theta": [1.5]},
        {"name": "coulomb", "joints": [2], "shape": [], "theta": [2.5]},
    ]
    model = Model(
        robot=arm(),
        inertial=read_inertial_parameters(arm().model),
        terms=tuple(map(Term.from_record, terms)),
        speed_floor=np.array([0.01, 0.02]),
        clock=0.0,
    )
    return [model.to_record()]


@cache
def _log() -> Recording:
    t = np.arange(400) / 100
    q = np.column_stack([np.sin(2 * t), 0.5 * np.cos(3 * t)])
    return Recording("log", "two_link", t, q, q)


def _read_model(data: bytes, place: Path) -> None:
    file = place / "model.json"
    file.write_bytes(data)
    model = load_model(file)
    record = model.to_record()
    assert same_json(record, model_from_record(record).to_record())
    assert repr(model)
    robot = model.model.robot if isinstance(model, CorrectedModel) else model.robot
    if robot.dof == 2:
        assert model.predict(_log()).shape == (400, 2)
    model.save(place / "again.json")
    assert same_json(load_model(place / "again.json").to_record(), record)


@cache
def _verdicts() -> list[dict]:
    folder = ROOT / "tests" / "frozen"
    texts = [(folder / f"{n}.json").read_text() for n in ("effects", "unknown")]
    verdicts = [json.loads(text) for text in texts]
    return [_short(document) for document in verdicts]


def _short(value: object) -> object:
    if isinstance(value, dict):
        return {k: _short(v) for k, v in value.items()}
    if isinstance(value, list):
        some = value[:2] if any(isinstance(v, dict) for v in value) else value
        return [_short(v) for v in some]
    return value


def _read_verdict(data: bytes, place: Path) -> None:
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError("no JSON") from error  # the store's own affair
    verdict = parse_verdict(document)
    assert str(verdict)
    assert repr(verdict.effects)
    told = to_json(verdict)
    assert same_json(to_json(from_json(told)), told)


def _read_words(data: bytes, place: Path) -> None:
    words = data.decode("utf-8", errors="replace").replace("\0", "")
    (place / "log.csv").write_text(as_csv())
    log, understood = read_log(f"{place}/{words}", arm(), despite_doubts=True)
    assert 2 <= len(log.t) <= len(samples())
    assert understood.rows == len(log.t)


_CUTS = [b"log.csv", b"log.csv@0:2.5", b"log.csv@10%:90%", b"log.csv@1:", b"log.csv@:2"]


def _json(name: str, documents, read) -> Reader:
    def seeds() -> list[bytes]:
        return [json.dumps(document).encode() for document in documents()]

    def inputs() -> st.SearchStrategy[bytes]:
        twice = mutated_json(documents())
        return st.one_of(twice, twice, mutated(seeds()))

    return Reader(name, inputs, seeds, read)


RECORDS = (
    _json("model", _models, _read_model),
    _json("verdict", _verdicts, _read_verdict),
    Reader("window", lambda: mutated(_CUTS, (b"@", b":", b"%")), lambda: _CUTS, _read_words),
)
