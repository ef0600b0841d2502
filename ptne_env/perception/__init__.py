"""What a policy sees, and how it answers."""
