"""Write results as records of the store, and read them back."""
