"""Export of scenes to the files of other programs."""
