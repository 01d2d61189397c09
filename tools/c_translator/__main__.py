"""The table of the compiled step against its C translation: python -m tools.c_translator [--source]."""

from __future__ import annotations

import argparse

from tools.c_translator.build import ROUNDS, compare, source


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m tools.c_translator", description=__doc__)
    parser.add_argument("--source", action="store_true", help="print the C instead")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    args = parser.parse_args()
    if args.source:
        print(source(), end="")
        return
    print(f"{'operating point':<22}{'compiled':>11}{'gcc -O2':>11}{'ratio':>8}   lowest–highest")
    for name, figures in compare(args.rounds).items():
        times = f"{figures.compiled * 1e9:8.0f} ns{figures.translation * 1e9:8.0f} ns"
        spread = f"{figures.lowest:.2f}–{figures.highest:.2f}"
        print(f"{name:<22}{times}{figures.ratio:8.2f}   {spread:>14}")


if __name__ == "__main__":
    main()
