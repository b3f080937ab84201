"""The command line. Each command is one module that parses the options, calls the library and prints the result."""
