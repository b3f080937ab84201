"""Each frame's points: storage, densification, spacing."""
