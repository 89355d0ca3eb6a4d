"""Commands that close the loop: which model a robot has, and what follows from it."""
