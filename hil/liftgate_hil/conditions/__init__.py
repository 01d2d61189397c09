"""Conditions on a run: parser into a postfix table, and the evaluator for triggers, expectations and judge.

    gate_angle_deg > 20 and (sensed.left_current_a > 2 * $idle or Gate.LatchState == 1)

In each tick, a condition has a truth value and a margin: how much is left before the truth value changes, in the
unit of the comparison that decides.

    a < b: b − a      a == b: −|a − b|      a != b: |a − b|      and: the smaller    or: the larger    not: negated

Where one of its columns has no value, or a value that is not finite, the condition has neither (margin NaN).
"""
