"""What remains after the findings, and what it depends on."""
