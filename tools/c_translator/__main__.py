"""The table of the compiled step against its C translation: python -m tools.c_translator [--source]."""

from __future__ import annotations

import argparse

from tools.c_translator.build import BUILDS, ROUNDS, compare, source


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m tools.c_translator", description=__doc__)
    parser.add_argument("--source", action="store_true", help="print the C instead")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    args = parser.parse_args()
    if args.source:
        print(source(), end="")
        return
    figures = compare(args.rounds)
    for each in BUILDS:
        print(f"{each.name}: {' '.join((each.compiler, *each.flags))}")
        if not each.is_installed:
            print("  not installed")
            continue
        for name, point in figures.items():
            ratios = point.ratios[each.name]
            print(
                f"  {name:<22}{point.compiled * 1e9:6.0f} ns :"
                f"{point.translations[each.name] * 1e9:6.0f} ns  ratio {point.ratio(each.name):.2f}"
                f"  ({min(ratios):.2f} to {max(ratios):.2f})"
            )


if __name__ == "__main__":
    main()
