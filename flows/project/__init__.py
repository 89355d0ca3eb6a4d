"""A project of one's own: what `modelgap.toml` says, and what is served from it."""
