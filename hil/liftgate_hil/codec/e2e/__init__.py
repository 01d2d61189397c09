"""AUTOSAR end-to-end (E2E) protection."""
