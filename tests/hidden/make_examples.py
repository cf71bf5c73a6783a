"""Makes examples/hidden anew: `python -m tests.hidden.make_examples`."""

from __future__ import annotations

from pathlib import Path

from tests.hidden import random_case, write

FOLDER = Path(__file__).parents[2] / "examples" / "hidden"
SEED, CHANGE = 8, 0.05


def main() -> None:
    """Ten recordings in which friction falls with speed, by a few per cent of F_p and d."""
    case = random_case(SEED, "stribeck", change=CHANGE, n=10, stroke=1e-3)
    print(write(case, FOLDER), case.effects)


if __name__ == "__main__":
    main()
