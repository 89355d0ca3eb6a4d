"""From logged samples to kinematics, filtered torque and the rows that count."""
