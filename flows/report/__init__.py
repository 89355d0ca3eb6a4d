"""The verdict told to people: in the terminal and on one HTML page."""
