"""SPEC.toml and campaign files, checked."""
