"""The picture of watched runs: its alarms are told apart however close they are."""

from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from flows.report.figures.scores import _mark, plot
from residual.monitoring.monitor import Alarm


def alarm(time: float, joint: int) -> Alarm:
    return Alarm(time, joint, "encoder", "jump", "step", 3.0, time + 1.0)


def test_numbers_of_alarms_lie_over_nothing_and_names_stand_in_the_title():
    figure = Figure(figsize=(9, 3), layout="constrained")
    axes = figure.subplots()
    axes.plot([0.0, 20.0], [1.0, 1.0])
    alarms = [alarm(10.0 + x, joint) for joint, x in enumerate((5.0, 5.05, 5.1), 1)]
    words = _mark(axes, alarms, 10.0)
    assert words == "1: jump, joint 1   2: jump, joint 2   3: jump, joint 3"
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axes.texts]
    assert [text.get_text().strip() for text in axes.texts] == ["1", "2", "3"]
    for i, one in enumerate(boxes):
        assert not any(one.overlaps(other) for other in boxes[i + 1 :])
    many = _mark(axes, [alarm(float(k), 1) for k in range(9)], 0.0)
    assert many.endswith("   5 more")


def test_runs_with_alarms_come_first(tmp_path):
    t = np.linspace(0, 20, 400)
    scores = SimpleNamespace(values=np.ones((400, 2)), t=t, kind="step")
    found = SimpleNamespace(
        monitor=SimpleNamespace(scores=lambda run: [scores]),
        alarms={"a" * 20: (), "b" * 20: (alarm(3.0, 2),)},
    )
    runs = {id: SimpleNamespace(t=t) for id in found.alarms}
    path = tmp_path / "scores.png"
    path.write_bytes(plot(found, runs))
    assert Image.open(path).size[1] > 400
