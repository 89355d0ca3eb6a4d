"""Results as records of the store, and back."""
