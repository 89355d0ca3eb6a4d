"""What the simulated world rests on: records, laws of friction, PyBullet, geometry."""
