"""The command `fourd render` and its options."""
