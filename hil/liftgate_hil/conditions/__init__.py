"""Conditions on what a run shows: text → postfix table, and the one evaluator, for triggers, expectations, judge.

    gate_angle_deg > 20 and (sensed.left_current_a > 2 * $idle or Gate.LatchState == 1)

A condition has, in each tick, a truth and a margin: how much is left before the truth changes, in the unit of the
comparison that decides.

    a < b: b − a      a == b: −|a − b|      a != b: |a − b|      and: the smaller    or: the larger    not: negated

A tick in which one of its columns has no value, or a value that is not finite, has neither (margin NaN).
"""
