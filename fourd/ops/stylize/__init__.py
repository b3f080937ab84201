"""The image filter that turns the visible surface of a picture into a cartoon or a drawing."""
