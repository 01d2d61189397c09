"""Results of identification and validation for people and programs: terminal text, JSON, figures, one HTML page."""
