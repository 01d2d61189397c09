"""Recording file formats: writers behind the `Writer` protocol, readers behind `Recording`; suffix selects."""
