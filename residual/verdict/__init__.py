"""The verdict of a diagnosis: its records, its JSON, and the edit test."""
