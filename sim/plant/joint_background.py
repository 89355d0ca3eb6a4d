"""What every joint of a used arm has beside its model: undeclared, small, of own form.

Drawn from the seed of the arm, the same in all its runs; the laws stand in
`sim.engine.friction_laws`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from residual.errors import check_name
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.plant_records import CLEAN, BackgroundWord, create_random_stream
from sim.plant.typical_sizes import estimate_typical_sizes

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
USUAL_SPEED = 0.35  # of the robot's usual speed


@dataclass(frozen=True, eq=False, slots=True)
class JointBackground:
    """What one arm has on all joints, and no file declares."""

    span: Array  # torque range that sizes go by [N m], (dof,)
    level: Array  # extra dry friction at rest [N m], (dof,)
    speed: Array  # speed at which a third of it is left [rad/s], (dof,)
    press: Array  # friction per torque that the gear carries, at its range, (dof,)
    lean: Array  # part by which dry friction is more forwards, less backwards, (dof,)
    growth: Array  # cold friction over warm one, less one, (dof,)
    oil: Array  # time constant of the oil [s], (dof,)
    housing: Array  # time constant of the housing [s], (dof,)
    ripple: Array  # amplitude of each wave of cogging [N m], (h, dof)
    order: Array  # waves per turn, (h, dof)
    phase: Array  # phase of each wave [rad], (h, dof)
    gain: Array  # reported torque over real torque, less one, (dof,)
    twist: Array  # twist of the gear under the torque range [rad], (dof,)
    cutoff: Array  # corner of the low pass that torque goes through [Hz], (dof,)
    step: Array  # step of the reported torque [N m], (dof,)

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
    robot: Robot, level: BackgroundWord, seed: int, coulomb: Array
) -> JointBackground | None:
    """Draw the background of one arm.

    Args:
        level: How much of it: "clean", "workshop", or twice as much, "worn".
        coulomb: True Coulomb friction of the arm [N m]. Shape (dof,).
    """
    scale = _SCALE[check_name(level, _SCALE, "background of the plant")]
    if scale == 0:
        return None
    span, dof = estimate_typical_sizes(robot).torque, robot.dof

    def uniform(name: str, low: float, high: float) -> Array:
        return create_random_stream(seed, f"background/{name}").uniform(low, high, dof)

    loss, time = scale * uniform("loss", *_LOSS), uniform("time", *_TIME)
    waves = _waves(scale * uniform("peak", *_RIPPLE) * span, seed)
    return JointBackground(
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
    rng, dof = create_random_stream(seed, "background/waves"), len(amplitude)
    multiple, weight = np.array(_HARMONICS).T[:, :, None]
    order = multiple * rng.uniform(*_ORDERS, dof)
    phase = rng.uniform(0.0, 2 * np.pi, order.shape)
    turn = np.linspace(-np.pi, np.pi, 7201)[:, None, None]
    peak = np.abs((weight * np.sin(order * turn + phase)).sum(axis=1)).max(axis=0)
    return np.array([weight * amplitude / peak, order, phase])


def compute_start_warmth(background: JointBackground, working_time: float) -> Array:
    """Return the warmth of oil and housing after so long of usual work. (2, dof)."""
    return 1.0 - np.exp(-working_time / np.array([background.oil, background.housing]))


def compute_usual_friction_power(coulomb: Array, viscous: Array, speed: Array) -> Array:
    """Return the power of friction in usual work, which warms by one unit [W]."""
    return coulomb * speed + viscous * speed**2 + 1e-9


def simulate_torque_logging(background: JointBackground | None, tau: Array, rate: float) -> Array:
    """Return what is logged of a torque: through a low pass, in whole steps [N m].

    Args:
        background: That of the arm; a clean one logs what it is given.
    """
    if background is None:
        return tau
    from scipy.signal import lfilter

    out = np.empty_like(tau)
    for j, corner in enumerate(background.cutoff):
        keep = np.exp(-2 * np.pi * corner / rate)
        at_rest = [keep * tau[0, j]]
        out[:, j], _ = lfilter([1 - keep], [1, -keep], tau[:, j], zi=at_rest)
    return np.round(out / background.step) * background.step
