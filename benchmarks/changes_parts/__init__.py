"""What changed between two epochs of an arm: cases, sizes, methods and bars."""
