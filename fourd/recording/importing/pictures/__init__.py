"""Image files of a source: pairing by moment, and checks of sizes, orientations and masks."""
