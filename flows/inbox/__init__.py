"""Logs that drop into a folder: stored once or refused, and then diagnosed."""
