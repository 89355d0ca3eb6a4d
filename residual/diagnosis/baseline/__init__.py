"""What logs of the arm as commissioned teach: its model, and how well it repeats."""
