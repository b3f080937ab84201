"""Commands that show, render, pack, verify and describe scenes, and a benchmark."""
