"""Valid files, a little changed: in their bytes, in their words, in their structure."""

import json
import re
from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

from hypothesis import strategies as st

Draw = Callable[[st.SearchStrategy], Any]

# What a format may take for something else, or may not expect at all.
ODD_WORDS = (
    *(b"", b"0", b"-1", b"1", b"2", b"7.5", b"1e308", b"-1e-320", b"1e999", b"nan"),
    *(b"inf", b"-", b"+", b"0x10", b"1_0", b"1,5", b"9" * 30, b"9" * 400, b"9" * 5000),
    *(b"true", b"null", b'""', b"''", b'"', b"'", b"[", b"]", b"{", b"}", b"[]", b"{}"),
    *(b"[[", b"]]", b"=", b",", b";", b":", b".", b"\t", b"\n", b"\r", b"\r\n", b"#"),
    *(b"<", b">", b"/", b"&", b"&#0;", b"\\", b"\\ud800", b"%", b"@", b"\0"),
    b"\x1b[31m",
    *"∞ ² é \u202e \ufeff ٣".encode().split(b" "),
    *(b"\xff\xfe", b"\x80", b"[" * 3000),
    *(b"2026-01-01T00:00:00Z", b"__class__", b"../x", b"/dev/zero", b"x" * 300),
)
ODD_VALUES = (
    *(None, True, False, 0, 1, -1, 2, 7, 2**31, 2**63, 2**70, -(10**30), 10**400),
    *(0.5, -0.0, 1e308, 1e-320, float("inf"), float("nan"), "", "x", "1", "nan"),
    *("\ud800", "\0", "\x1b[31m", "é", "x" * 300, [], {}, [[]], [None], [0], [1, 2, 3]),
    *([1e308] * 2, ["x"], {"x": 1}, {"value": None}, [{}], [[1, 2], [3]], [[[1.0]]]),
)
_TOKEN = re.compile(rb"\w+|\s+|[^\w\s]")


def mutated(seeds: Sequence[bytes], words: Sequence[bytes] = ()) -> st.SearchStrategy[bytes]:
    """Return a strategy of files that are a few edits away from valid ones."""
    vocabulary = (*words, *ODD_WORDS)
    return st.one_of(_by_words(list(seeds), vocabulary), _by_bytes(list(seeds), vocabulary))


def flipped(seeds: Sequence[bytes]) -> st.SearchStrategy[bytes]:
    return _by_bytes(list(seeds), ODD_WORDS)


@st.composite
def _by_bytes(draw: Draw, seeds: list[bytes], words: Sequence[bytes]) -> bytes:
    # By number: hypothesis writes down what it samples from.
    data = bytearray(seeds[draw(st.integers(0, len(seeds) - 1))])
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data)))
        kind = draw(st.sampled_from(("bit", "byte", "word", "cut", "double", "end")))
        size = draw(st.sampled_from((1, 2, 4, 8, 64, 1024)))
        if kind == "bit" and at < len(data):
            data[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == "byte" and at < len(data):
            data[at] = draw(st.integers(0, 255))
        elif kind == "word":
            data[at:at] = draw(st.sampled_from(words))
        elif kind == "cut":
            del data[at : at + size]
        elif kind == "double":
            data[at:at] = data[at : at + size]
        elif kind == "end":
            del data[at:]
    return bytes(data)


@st.composite
def _by_words(draw: Draw, seeds: list[bytes], words: Sequence[bytes]) -> bytes:
    tokens = _TOKEN.findall(seeds[draw(st.integers(0, len(seeds) - 1))])
    for _ in range(draw(st.integers(1, 5))):
        if not tokens:
            break
        at = draw(st.integers(0, len(tokens) - 1))
        kind = draw(st.sampled_from(("other", "more", "own", "drop", "swap", "run")))
        to = draw(st.integers(0, len(tokens) - 1))
        if kind == "other":
            tokens[at] = draw(st.sampled_from(words))
        elif kind == "more":
            tokens.insert(at, draw(st.sampled_from(words)))
        elif kind == "own":
            tokens[at] = tokens[to]
        elif kind == "drop":
            del tokens[at : at + draw(st.sampled_from((1, 2, 5, 40)))]
        elif kind == "swap":
            tokens[at], tokens[to] = tokens[to], tokens[at]
        else:
            tokens[at:at] = tokens[min(at, to) : max(at, to)][:60]
    return b"".join(tokens)


def mutated_json(documents: Sequence[Any], most: int = 3) -> st.SearchStrategy[bytes]:
    """Return a strategy of JSON with values, keys and lists that are unexpected."""
    return changed(documents, most).map(lambda d: json.dumps(d).encode())


@st.composite
def changed(draw: Draw, documents: Sequence[Any], most: int = 3) -> Any:
    document = deepcopy(documents[draw(st.integers(0, len(documents) - 1))])
    for _ in range(draw(st.integers(1, most))):
        places = list(_places(document, ()))
        if not places:
            return draw(st.sampled_from(ODD_VALUES))
        *path, key = draw(st.sampled_from(places))
        kind = draw(st.sampled_from(("odd", "odd", "drop", "twice", "wrap", "own")))
        inside = _at(document, path)
        if kind == "drop":
            del inside[key]
        elif kind == "twice" and isinstance(inside, list):
            inside.insert(key, deepcopy(inside[key]))
        elif kind == "twice":
            other = draw(st.sampled_from(("x", "", "name", "tables", key.upper())))
            inside[other] = inside[key]
        elif kind == "wrap":
            inside[key] = [inside[key]]
        elif kind == "own":
            inside[key] = deepcopy(_at(document, draw(st.sampled_from(places))))
        else:
            # A copy: a later change may be inside of it.
            inside[key] = deepcopy(draw(st.sampled_from(ODD_VALUES)))
    return document


def _at(document: Any, path: Sequence) -> Any:
    for step in path:
        document = document[step]
    return document


def _places(document: Any, path: tuple) -> list[tuple]:
    """Return the path of every value, only the first five of a long list."""
    if isinstance(document, dict):
        items = list(document.items())
    elif isinstance(document, list):
        items = list(enumerate(document))[:5]
    else:
        return []
    places = []
    for key, value in items:
        places += [(*path, key), *_places(value, (*path, key))]
    return places
