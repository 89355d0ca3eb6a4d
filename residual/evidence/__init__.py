"""Columns of every candidate, and how much evidence the logs give a set of them."""
