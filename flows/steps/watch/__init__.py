"""A robot watched while it runs: from samples that come to alarms and diagnoses."""
