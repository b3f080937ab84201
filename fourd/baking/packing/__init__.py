"""Writing of packed scenes, whose frames are quantised and compressed. Each frame can be decoded without the other
frames."""
