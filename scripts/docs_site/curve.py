"""The curve of an effect, as a small SVG, drawn from the effect's own columns.

The arm is the built-in one on smooth made-up motion; every effect is of the size at
which its largest torque is one. Along the horizontal axis runs what the effect itself
says it is best seen over.
"""

from functools import cache

import numpy as np

from residual.effects import list_effect_parameters
from residual.effects.base import Effect, MotionSpan, State, against_position
from residual.model.model import Term
from residual.model.nominal import build_nominal, choose_declared_effects
from residual.robot.robot import load_robot

ROBOT, RATE, SECONDS = "irb140", 100.0, 20.0
WIDTH, HEIGHT, LEFT, RIGHT, TOP, LOW = 460, 220, 58, 12, 12, 44
MOST = 900  # points


@cache
def _seen() -> tuple[State, MotionSpan]:
    """The motion: two sines per joint that never meet again, and what it reaches."""
    robot = load_robot(ROBOT, list_effect_parameters())
    t = np.arange(0, SECONDS, 1 / RATE)
    w = 2 * np.pi * np.array([0.23, 0.61])[:, None] * (1 + 0.07 * np.arange(robot.dof))
    size = np.array([0.7, 0.25])[:, None]
    phase = t[:, None, None] * w + 0.9 * np.arange(robot.dof)
    motion = (
        (size * np.sin(phase)).sum(axis=1),
        (size * w * np.cos(phase)).sum(axis=1),
        (-size * w**2 * np.sin(phase)).sum(axis=1),
    )
    span = _span(motion, np.zeros(robot.dof))
    names = choose_declared_effects(robot, None)
    model = build_nominal(robot, names, span, np.full(robot.dof, 1e-3)).model
    state = model.state(RATE, t, motion)
    return state, _span(motion, np.abs(state.tau_model).max(axis=0))


def _span(motion, torque) -> MotionSpan:
    q, qd, _ = motion
    return MotionSpan(np.quantile(abs(qd), 0.95, 0), np.ptp(q, 0), SECONDS, 8.0, torque)


def points(effect: Effect) -> tuple[np.ndarray, np.ndarray, str]:
    """Return x, torque over its largest, and the label of x with its unit."""
    state, span = _seen()
    joints = effect.candidates(state.robot.dof)
    on = joints[min(1, len(joints) - 1)]
    shapes = effect.shapes(span, on[0] if on else 1)
    shape = shapes[(len(shapes) - 1) // 2] if shapes else ()
    count = effect.columns(state, on, shape).shape[2]
    theta = effect.unit_directions([state], on)[0] if effect.unit_directions else np.ones(count)
    torque = Term(effect, on, shape, theta).torque(state)
    # Of an effect on many rows, the row that it moves most.
    row = int(np.argmax(np.square(torque).sum(axis=0)))
    y = torque[:, row] / max(float(np.abs(torque[:, row]).max()), 1e-12)
    # Where no one variable explains it, the cloud over the joint's angle says so.
    x, label = (effect.variable or against_position)(state, row)
    return x, y, label


def svg(effect: Effect) -> str:
    """Return the drawing, with a text that says what it shows."""
    x, y, label = points(effect)
    keep = slice(None, None, max(1, len(x) // MOST))
    low, high = float(x.min()), float(x.max())
    wide = max(high - low, 1e-12)
    px = LEFT + (x[keep] - low) / wide * (WIDTH - LEFT - RIGHT)
    middle, half = (TOP + HEIGHT - LOW) / 2, (HEIGHT - LOW - TOP) / 2
    dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(px, middle - half * y[keep], strict=True))
    return "\n".join(
        [
            f'<svg class="curve" role="img" viewBox="0 0 {WIDTH} {HEIGHT}" '
            f'xmlns="http://www.w3.org/2000/svg"><title>Torque of {effect.name} over '
            f"{label}, one dot per sample</title>",
            f'<path class="axis" d="M{LEFT} {TOP}V{HEIGHT - LOW}H{WIDTH - RIGHT}'
            f'M{LEFT} {middle:.1f}H{WIDTH - RIGHT}"/>',
            f'<path class="dots" d="{dots}"/>',
            *_labels(low, high, middle, label),
            "</svg>",
        ]
    )


def _labels(low: float, high: float, middle: float, label: str) -> list[str]:
    at = [
        (LEFT, HEIGHT - LOW + 16, "start", f"{low:.2g}"),
        (WIDTH - RIGHT, HEIGHT - LOW + 16, "end", f"{high:.2g}"),
        ((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, "middle", label),
        (LEFT - 6, TOP + 8, "end", "+1"),
        (LEFT - 6, middle + 4, "end", "torque"),
        (LEFT - 6, HEIGHT - LOW, "end", "-1"),
    ]
    return [
        f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}">{text}</text>'
        for x, y, anchor, text in at
    ]
