"""The image filter that turns a rendered surface into a cartoon or a drawing."""
