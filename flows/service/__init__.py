"""The server, worker and schedules that `modelgap up` keeps running for a store."""
