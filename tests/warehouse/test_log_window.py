"""Windows of logs and the labels of recordings."""

import numpy as np
import pytest

from residual.errors import InputError
from warehouse.logs import read_log, unique_ids


@pytest.mark.parametrize(
    ("window", "first", "last"),
    [
        ("0:2.5", 0, 249),
        ("1:", 100, 399),
        (":3", 0, 299),
        ("1.5:4", 150, 399),
        ("40%:", 160, 399),
        (":60%", 0, 239),
        ("0%:100%", 0, 399),
        ("1:75%", 100, 299),
    ],
)
def test_window_is_closed_at_its_start_and_open_at_its_end(
    robot, samples, write, window, first, last
):
    samples[:, 0] += 17
    recording, understood = read_log(f"{write(samples)}@{window}", robot)
    np.testing.assert_array_equal(recording.t, samples[first : last + 1, 0])
    assert recording.id == f"run@{window}"
    assert understood.window == window


@pytest.mark.parametrize("cut", ["50%", "2", "3.9999", "2.003", "57%", "2.0099999"])
def test_two_halves_share_no_sample_and_lose_none(robot, samples, write, cut):
    path = write(np.vstack([samples, samples + np.array([4, 0, 0, 0, 0])]))
    rows = [read_log(f"{path}@{w}", robot)[1].rows for w in (f":{cut}", f"{cut}:")]
    assert sum(rows) == 800


@pytest.mark.parametrize(
    ("window", "message"),
    [
        ("0:5", "outside the log, which lasts 4 s"),
        ("4:", "outside the log"),
        ("9:12", "outside the log"),
        ("101%:", "101% is outside"),
        ("3:2.5", "is empty"),
        ("2:2", "is empty"),
        ("1", "not understood, expected @start:end"),
        ("-1:2", "not understood"),
        ("a:b", "not understood"),
        ("", "not understood"),
        ("0:1", "expected at least 2 s"),
        ("1:1.005", "1 samples"),
    ],
)
def test_bad_windows_are_refused(robot, samples, write, window, message):
    with pytest.raises(InputError, match=message):
        read_log(f"{write(samples)}@{window}", robot)


def test_a_file_of_the_full_name_wins(robot, samples, write):
    recording, understood = read_log(write(samples, name="run.csv@0:1"), robot)
    assert (len(recording.t), understood.window) == (400, None)


def test_nan_outside_the_window_does_no_harm(robot, samples, write):
    samples[10, 3] = np.nan
    assert read_log(f"{write(samples)}@1:", robot)[1].rows == 300


def test_labels_are_short_and_never_alike(samples, tmp_path):
    for folder in ("a", "b", "c/a"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "run.csv").touch()
    (tmp_path / "a" / "other.csv").touch()
    a, b, c = (str(tmp_path / f / "run.csv") for f in ("a", "b", "c/a"))
    other = str(tmp_path / "a" / "other.csv")
    assert unique_ids([a, other]) == ["run", "other"]
    assert unique_ids([f"{a}@:2", f"{a}@2:"]) == ["run@:2", "run@2:"]
    assert unique_ids([a, b]) == ["a/run.csv", "b/run.csv"]
    assert unique_ids([a, c]) == ["a/run.csv (1)", "a/run.csv (2)"]
