"""Logs of a quasi-static synthetic arm with one or more hidden effects.

The motion is given, the torque follows from it. There is no controller and no
simulation over time, so that many logs cost little; `sim.synthetic.logs` is the door.
The formulas of the hidden effects are deliberately not those of the diagnosis.
"""
