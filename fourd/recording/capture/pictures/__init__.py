"""Image files of a capture: which of them belong to the same moment, and what alpha channels and masks mean."""
