"""Given cameras brought into agreement with the pictures, before anything is carved from them."""
