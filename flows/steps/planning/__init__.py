"""The next experiment: what is open, which motion answers it, and running it."""
