"""The arm: its description, its rigid-body dynamics, and what a motion can tell of it."""
