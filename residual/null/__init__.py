"""Recordings in which nothing is missing: what chance alone brings about."""
