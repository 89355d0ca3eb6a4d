"""Motions that an arm is asked to make: four families within its limits."""

from sim.trajectories.limits import LimitError
from sim.trajectories.reference import KINDS, make_reference

__all__ = ["KINDS", "LimitError", "make_reference"]
