"""What all reports share: numbers, drawing, tables, HTML pages, figures of a run, provenance, files."""
