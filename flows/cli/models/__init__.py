"""Commands about a model: its torque, and other programs."""
