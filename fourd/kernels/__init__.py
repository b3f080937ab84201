"""What all rooms need to call the native kernels: the module, its threads and instruction set, and a GPU's memory."""
