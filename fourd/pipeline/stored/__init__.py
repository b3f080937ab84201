"""A folder for intermediate results in an object store: each machine works in a local copy, and publishes each finished
stage."""
