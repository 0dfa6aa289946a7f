"""The terrain simulator: experiments, and their chapter of the report."""
