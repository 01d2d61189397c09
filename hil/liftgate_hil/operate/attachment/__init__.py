"""Attachment of clients in other processes to a run: they read its loop's memory and send commands."""
