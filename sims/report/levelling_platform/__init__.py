"""The levelling platform's chapter of the report."""
