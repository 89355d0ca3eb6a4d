"""The parameters of a model from logs, and whether a body can have them."""
