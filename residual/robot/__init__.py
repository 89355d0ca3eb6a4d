"""The arm: description, rigid-body dynamics, and observability of its inertia."""
