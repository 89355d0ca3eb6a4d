"""Monitoring of sensors."""
