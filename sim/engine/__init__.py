"""The basis of the simulation: records, laws of friction, PyBullet, geometry."""
