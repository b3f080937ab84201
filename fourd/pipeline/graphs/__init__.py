"""The lists of stages: which stages an input needs, in which order."""
