"""Columns of every candidate, and the evidence of the logs for a set of them."""
