"""Past findings and valid files: an answer that is right, or an error that is clear."""

import pytest

from tests.fuzz.campaign import CORPUS
from tests.fuzz.reader import judge
from tests.fuzz.run import READERS

CASES = sorted(path.relative_to(CORPUS).as_posix() for path in CORPUS.glob("*/*.bin"))


@pytest.mark.parametrize("case", CASES)
def test_what_was_found_once_is_mended(tmp_path, case):
    path = CORPUS / case
    assert judge(READERS[path.parent.name], path.read_bytes(), tmp_path) is None


@pytest.mark.parametrize("name", READERS)
def test_what_is_mutated_was_valid(tmp_path, name):
    reader = READERS[name]
    for at, data in enumerate(reader.seeds()):
        place = tmp_path / str(at)
        place.mkdir()
        reader.read(data, place)


def test_every_case_belongs_to_a_reader():
    assert {path.name for path in CORPUS.iterdir() if path.is_dir()} <= set(READERS)
