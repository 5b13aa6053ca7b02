"""What is refused, in tables of messages and calls."""
