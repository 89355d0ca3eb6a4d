"""Doubts of what was found: each name, and the model as a whole."""
