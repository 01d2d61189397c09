"""Study of identification on measurements of known truth: `python -m tools.identification --help`."""
