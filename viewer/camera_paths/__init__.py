"""Camera paths of the user's own: key frames and their interpolation, files of fourd and of nerfstudio, and timing."""
