"""What `fourd info` says about files, folders and machines."""
