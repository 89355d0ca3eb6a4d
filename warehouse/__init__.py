"""The store: reads measured logs, keeps runs, models and verdicts, answers SQL."""
