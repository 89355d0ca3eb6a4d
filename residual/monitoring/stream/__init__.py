"""Watching an arm while it runs: samples in, alarms out, in batches of any size."""
