"""The equation that an effect's page shows is what its columns compute."""

import re

import numpy as np
import pytest

from residual.effects import registry
from tests.residual.arms import arm
from tests.residual.test_effects import state

# Plain functions of the joint's own state: what a reader could type into a calculator.
PLAIN = {
    "q": lambda s: s.q[:, 0],
    "qd": lambda s: s.qd[:, 0],
    "qdd": lambda s: s.qdd[:, 0],
    "t": lambda s: s.t,
    "sgn": lambda s: np.sign,
    "sin": lambda s: np.sin,
    "cos": lambda s: np.cos,
    "exp": lambda s: np.exp,
    "tau": lambda s: s.tau_model[:, 0],
    "rigid": lambda s: s.rigid[:, 0],
    "clip": lambda s: np.clip,
}


def _plain(effect) -> bool:
    return effect.scope == "local" and not effect.remembers


LOCAL = sorted(name for name, effect in registry().items() if _plain(effect))


def _evaluate(equation, values, seen):
    """The right-hand side as Python: bars are sizes, a caret a power."""
    right = equation.partition("=")[2].partition(":")[0].partition(", exponent")[0]
    right = right.replace("rigid-body torque", "rigid").replace("^", "**")
    right = re.sub(r"\|([^|]+)\|", r"abs(\1)", right)
    known = {name: of(seen) for name, of in PLAIN.items()}
    # A name before a bracket is a function, also where a parameter is called so.
    functions = {f"f_{name}": known[name] for name in ("sin", "cos", "exp")}
    right = re.sub(r"\b(sin|cos|exp)\(", r"f_\1(", right)
    return eval(right, {"abs": np.abs}, {**known, **functions, **values})


def test_the_effects_that_are_tried_here_are_most():
    assert len(LOCAL) >= 15


@pytest.mark.parametrize("name", LOCAL)
def test_the_equation_is_what_the_columns_compute(name):
    effect, robot = registry()[name], arm()
    numbers = [1.3, 0.7, 0.4][: len(effect.parameters)]
    if "exponent" in effect.parameters:
        numbers[-1] = 0.6
    theta, shape = effect.from_values(np.array(numbers), robot)
    seen = state(robot)
    columns = effect.columns(seen, (0,), shape)[:, 0, :]
    values = dict(zip(effect.parameters, numbers, strict=True))
    np.testing.assert_allclose(
        np.broadcast_to(_evaluate(effect.equation, values, seen), len(seen.t)),
        columns @ theta,
        atol=1e-12,
    )


def test_every_effect_has_an_equation_that_uses_its_parameters():
    for name, effect in registry().items():
        bodies = {"ixx", "ixy", "ixz", "iyy", "iyz", "izz", "com_x", "com_y", "com_z"}
        for key in set(effect.parameters) - bodies:
            assert re.search(rf"\b{key}\b", effect.equation), (name, key)
