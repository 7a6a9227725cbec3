"""The likeliest values of a hypothesis, how sure they are, and what they leave."""
