"""The arm under control: bodies, friction, transmission, drives and their faults.

`closed_loop` is the loop; each other file is one physical level. What an arm may hide
stands in `sim.effects`.
"""
