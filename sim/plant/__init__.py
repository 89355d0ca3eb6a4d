"""The arm under control: bodies, friction, transmission, drives and their faults.

`closed_loop` is the loop; each other file is one physical level. The effects that an arm
may hide are in `sim.effects`.
"""
