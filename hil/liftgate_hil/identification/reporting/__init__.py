"""Reports of identification and validation: terminal text, JSON, figures, one HTML page."""
