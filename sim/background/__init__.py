"""What every joint of a used arm has beside its model: undeclared, small, of own form.

None of its laws is one of `sim.effects` or of the diagnosis, so that nothing is found
only because both sides wrote down the same curve.
"""
