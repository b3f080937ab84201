"""Writing of packed scenes, whose frames are quantised and compressed such that each can be decoded without the
others."""
