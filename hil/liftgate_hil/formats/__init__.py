"""Recording formats behind the `Writer` protocol; the suffix of a file selects its format."""
