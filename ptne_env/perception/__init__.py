"""What a policy sees: interfaces, layouts, and the encoder that connects them to a running world."""
