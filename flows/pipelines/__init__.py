"""Prefect: tasks and flows over the steps, and what they show people."""
