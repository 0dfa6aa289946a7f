"""Claims, errata and drawings of the paper beside the results here."""
