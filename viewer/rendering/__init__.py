"""The renderers behind one interface, and the choice among them."""
