"""Documents that the program itself writes."""
