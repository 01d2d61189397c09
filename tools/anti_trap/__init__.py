"""Study of the reference ECU's anti-trap on many cars: docs/anti-trap.md.

trials      one gate that learns, runs undisturbed and meets rods
study       many trials: the whole travel in all conditions, drawn cars, wider and narrower limits, stiffer rods
figures     figures of the study, and their file
page        the page
picture     its picture
"""
