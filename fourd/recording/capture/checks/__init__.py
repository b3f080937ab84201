"""Parts of the check of a capture."""
