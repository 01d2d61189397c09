"""What the reference ECU's anti-trap does on many cars: docs/anti-trap.md.

trials      one gate that learns, runs free and meets rods
study       many of them: the whole travel in all conditions, drawn cars, wider and narrower limits, stiffer rods
page        the page and its figure
"""
