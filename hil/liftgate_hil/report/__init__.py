"""Shared parts of reports: numbers, drawing, tables, HTML pages, figures of a run, provenance, files."""
