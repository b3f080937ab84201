"""Commands that make or inspect captures."""
