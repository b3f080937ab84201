"""Clean plates to the first points of a static background."""
