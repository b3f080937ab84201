"""The command-line interface.

Each command is one module that parses the options, calls the library and prints the result.
"""
