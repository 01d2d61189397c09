"""End-to-end protection."""
