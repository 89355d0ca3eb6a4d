"""The arm under control: bodies, friction, transmission, drives and their faults.

`stepping` is the loop; `perturbations` lists what an arm may hide; each other file is
one physical level.
"""
