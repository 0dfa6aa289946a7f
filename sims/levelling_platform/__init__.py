"""The levelling platform: experiments, and its chapter of the report."""
