"""Training an agent, and exporting what it has learned."""
