"""Commands that train, evaluate and export runs."""
