"""Groups of the benchmark of projects, inboxes and stores of many robots."""
