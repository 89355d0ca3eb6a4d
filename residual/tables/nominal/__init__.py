"""Nominal-level PLSR: the paper's modified PLSR, compiled."""
