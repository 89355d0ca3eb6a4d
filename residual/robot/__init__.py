"""The arm: description, rigid-body dynamics, and what a motion tells of its inertia."""
