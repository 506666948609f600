"""How bytes move, and nothing of what they mean."""
