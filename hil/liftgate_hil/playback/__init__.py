"""Replay of recordings onto a bus."""
