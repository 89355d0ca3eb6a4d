"""The pages over a store as its server serves them."""
