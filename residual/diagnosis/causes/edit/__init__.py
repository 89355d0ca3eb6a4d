"""Taken out again: what a right cause passes and a good fit need not."""
