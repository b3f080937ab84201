"""The command line. Each command is one file, which parses the options, calls the library and prints the result."""
