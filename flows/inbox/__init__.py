"""Inboxes: import the logs in a folder, and diagnose the new runs."""
