"""Commands that show, render, time and describe scenes."""
