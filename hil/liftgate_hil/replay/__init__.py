"""Recordings played onto a bus."""
