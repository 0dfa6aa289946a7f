"""The machining centres: experiments, and their chapter of the report."""
