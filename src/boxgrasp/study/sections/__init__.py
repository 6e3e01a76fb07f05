"""The report's sections, a file each: what the thesis has, what comes out here."""
