"""The loop that closes itself: what it is to do next, and doing it."""
