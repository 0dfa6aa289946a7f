"""The walking chair: experiments, and its chapter of the report."""
