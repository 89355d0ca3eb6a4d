"""PyBullet and the geometry around it: integrator, camera, clearance, kinematics."""
