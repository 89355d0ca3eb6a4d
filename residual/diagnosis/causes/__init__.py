"""What else may have done it, and what moved: values, sets, and the edit test."""
