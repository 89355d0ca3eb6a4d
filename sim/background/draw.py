"""What an arm has of a background: drawn from its seed, the same in all its runs."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from residual.names import check_name
from residual.robot.robot import Robot
from sim.records import CLEAN, BackgroundWord
from sim.streams import stream
from sim.synthetic.sizes import sizes

Array = np.ndarray

# How much of everything there is.
_SCALE: Mapping[BackgroundWord, float] = {CLEAN: 0.0, "workshop": 1.0, "worn": 2.0}

# Engineering judgement, after logs of arms in use.
_LEVEL = (0.15, 0.5)  # of Coulomb friction
_SPEED = (0.03, 0.12)  # rad/s
_PRESS = (0.01, 0.05)  # of the torque that the gear carries
_LEAN = 0.08
_LOSS, _TIME = (0.05, 0.2), (100.0, 400.0)  # of all friction when warm; s
_QUICK = 0.25  # oil is so much quicker than the housing
_RIPPLE, _ORDERS = (0.003, 0.012), (6.0, 30.0)  # of the torque range; per turn
_HARMONICS = ((1.0, 1.0), (2.0, 0.5), (3.0, 0.3))  # order and weight
_GAIN = 0.04
_TWIST = (3e-4, 1.5e-3)  # rad under the torque range
_CUTOFF, _STEP = 40.0, 0.001  # Hz; of the torque range


@dataclass(frozen=True, eq=False, slots=True)
class Background:
    """What one arm has on all joints, and no file declares.

    Attributes:
        span: Torque range that sizes go by [N m]. Shape (dof,).
        level: Extra dry friction at rest [N m]. Shape (dof,).
        speed: Speed at which a third of it is left [rad/s]. Shape (dof,).
        press: Friction per torque that the gear carries, at its range. Shape (dof,).
        lean: Part by which dry friction is more forwards, less backwards. (dof,).
        growth: Cold friction over warm one, less one. Shape (dof,).
        oil: Time constant of the oil [s]. Shape (dof,).
        housing: Time constant of the housing [s]. Shape (dof,).
        ripple: Amplitude of each wave of cogging [N m]. Shape (h, dof).
        order: Waves per turn. Shape (h, dof).
        phase: Phase of each wave [rad]. Shape (h, dof).
        gain: Reported torque over real torque, less one. Shape (dof,).
        twist: Twist of the gear under the torque range [rad]. Shape (dof,).
        cutoff: Corner of the low pass that torque goes through [Hz]. Shape (dof,).
        step: Step of the reported torque [N m]. Shape (dof,).
    """

    span: Array
    level: Array
    speed: Array
    press: Array
    lean: Array
    growth: Array
    oil: Array
    housing: Array
    ripple: Array
    order: Array
    phase: Array
    gain: Array
    twist: Array
    cutoff: Array
    step: Array

    @property
    def waves(self) -> Array:
        """Amplitude, order and phase of each wave on each joint. Shape (h, dof, 3)."""
        return np.stack([self.ripple, self.order, self.phase], axis=-1)

    @property
    def drawn(self) -> dict[str, Array]:
        """Every number by name, those of several waves numbered. Shapes (dof,)."""
        out = {}
        for each in fields(self):
            value = getattr(self, each.name)
            if value.ndim == 1:
                out[each.name] = value
            else:
                out |= {f"{each.name}_{i}": v for i, v in enumerate(value, 1)}
        return out


def draw_background(
    robot: Robot, word: BackgroundWord, seed: int, coulomb: Array
) -> Background | None:
    """Draw the background of one arm.

    Args:
        robot: The robot; sizes go by its torques.
        word: How much of it: "clean", "workshop", or twice as much, "worn".
        coulomb: True Coulomb friction of the arm [N m]. Shape (dof,).

    Returns:
        The background, None for a clean arm.

    Raises:
        UnknownNameError: On another word.
    """
    scale = _SCALE[check_name(word, _SCALE, "background of the plant")]
    if scale == 0:
        return None
    span, dof = sizes(robot).torque, robot.dof

    def uniform(what: str, low: float, high: float) -> Array:
        return stream(seed, f"background/{what}").uniform(low, high, dof)

    loss, time = scale * uniform("loss", *_LOSS), uniform("time", *_TIME)
    waves = _waves(scale * uniform("peak", *_RIPPLE) * span, seed)
    return Background(
        span=span,
        level=scale * uniform("level", *_LEVEL) * coulomb,
        speed=uniform("speed", *_SPEED),
        press=scale * uniform("press", *_PRESS),
        lean=scale * uniform("lean", -_LEAN, _LEAN),
        growth=loss / (1.0 - loss),
        oil=_QUICK * time,
        housing=time,
        ripple=waves[0],
        order=waves[1],
        phase=waves[2],
        gain=scale * uniform("gain", -_GAIN, _GAIN),
        twist=scale * uniform("twist", *_TWIST),
        cutoff=np.full(dof, _CUTOFF / scale),
        step=scale * _STEP * span,
    )


def _waves(amplitude: Array, seed: int) -> Array:
    """Return amplitude, order and phase of waves whose sum has that peak. (3, h, dof).

    A gear and its harmonics, of a random phase each.
    """
    rng, dof = stream(seed, "background/waves"), len(amplitude)
    multiple, weight = np.array(_HARMONICS).T[:, :, None]
    order = multiple * rng.uniform(*_ORDERS, dof)
    phase = rng.uniform(0.0, 2 * np.pi, order.shape)
    turn = np.linspace(-np.pi, np.pi, 7201)[:, None, None]
    peak = np.abs((weight * np.sin(order * turn + phase)).sum(axis=1)).max(axis=0)
    return np.array([weight * amplitude / peak, order, phase])
