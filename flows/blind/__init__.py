"""The sealed study: hide effects, diagnose, open the seals, count."""
