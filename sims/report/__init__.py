"""The report: what the papers print beside what comes out here, in one HTML file."""
