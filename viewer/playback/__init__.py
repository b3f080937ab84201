"""Which frame is shown when, and reading ahead."""
