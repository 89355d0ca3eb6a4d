"""The parameters of a model from logs, and their physical consistency."""
