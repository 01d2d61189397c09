"""A campaign of mangled files and of signals at any moment against the command line."""
