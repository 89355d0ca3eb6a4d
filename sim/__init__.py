"""The simulated world: arms with hidden effects, and the logs of their sensors."""
