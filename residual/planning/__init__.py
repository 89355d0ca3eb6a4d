"""Which motion would tell apart what the logs so far leave open."""
