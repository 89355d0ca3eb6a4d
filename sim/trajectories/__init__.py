"""Motions that an arm is asked to make: four families within its limits."""

from sim.trajectories.planning_limits import MotionLimitError
from sim.trajectories.reference_planning import KINDS, plan_reference_motion

__all__ = ["KINDS", "MotionLimitError", "plan_reference_motion"]
