"""The goals of electric arms, servos and static poses: simulated machines with known hidden effects, scored.

    python pipelines/electric_arms.py [--rows arm,poses] [--seeds 0:9] [--workers N] [--work FOLDER] [--generate]

Seeds 0 to 9 are for development. Seeds 100 to 119 are published: only the final run uses them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from arms.generate import ROWS, generate

ROOT = Path(__file__).resolve().parents[1]


def seeds_of(text: str) -> list[int]:
    """``FIRST:LAST``, both included, or one number."""
    first, _, last = text.partition(":")
    return list(range(int(first), int(last or first) + 1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", default=",".join(ROWS), help="of the table, separated by commas")
    parser.add_argument("--seeds", default="0:9", help="FIRST:LAST, both included")
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "electric_arms", help="folder of cases and answers")
    parser.add_argument("--generate", action="store_true", help="write the cases and stop")
    given = parser.parse_args()
    for folder in generate(given.rows.split(","), seeds_of(given.seeds), given.work):
        print(folder)
