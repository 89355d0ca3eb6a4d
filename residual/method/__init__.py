"""The whole method: logs in, verdict out; and what a verdict is worth by chance."""
