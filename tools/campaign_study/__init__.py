"""Study of campaigns: docs/campaign-study.md.

algorithms  the search, and what it is compared with
pockets     analytic margins with a narrow pocket
minima      analytic test functions
estimates   analytic margins of known probability
product     the product's own campaigns, with the scenarios of this folder
study       all measurements
page        the page
"""
