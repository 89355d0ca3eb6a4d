"""Motions that separate the rivals left open by the logs."""
