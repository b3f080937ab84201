"""Other programs' captures, read into this project's conventions and written as a capture."""
