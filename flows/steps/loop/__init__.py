"""What closes the loop: models that are adopted, and what is done with them."""
