"""The walking chair: legs, body, passenger, and the directives that compose them."""
