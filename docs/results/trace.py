"""Draw episodes with damage: distance over time, with onset, suspicion and diagnosis.

Usage: ``python docs/results/trace.py OUT.svg SECONDS_A_STEP LABEL=TRACE.csv...`` takes what
``dappo-batch adapt --log`` writes.

It needs only Python and `curves.py`.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from itertools import accumulate
from pathlib import Path

from curves import COLOURS, document

WIDTH, HEIGHT, MARGIN = 760, 320, 56
MARKS = {"suspected": "suspicion", "adapted": "diagnosis"}
Row = dict[str, str]


def main() -> None:
    """Write the picture."""
    out, seconds, *traces = sys.argv[1:]
    labelled = [trace.partition("=") for trace in traces]
    walks = {label: read(Path(path)) for label, _, path in labelled}
    Path(out).write_text(picture(walks, float(seconds)), encoding="utf-8")


def read(path: Path) -> list[Row]:
    """Read a trace."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def distance(walk: list[Row], seconds: float) -> list[float]:
    """Return the distance walked after each step, m."""
    return list(accumulate(seconds * float(row["forward_velocity"]) for row in walk))


def picture(walks: dict[str, list[Row]], seconds: float) -> str:
    """Draw the walks as SVG."""
    lines = {label: distance(walk, seconds) for label, walk in walks.items()}
    top = 10 * -(-max(map(max, lines.values())) // 10)
    last = seconds * max(map(len, lines.values()))

    def x(step: float) -> float:
        return MARGIN + step * seconds / last * (WIDTH - 2 * MARGIN)

    def y(metres: float) -> float:
        return HEIGHT - MARGIN - max(metres, 0.0) / top * (HEIGHT - 2 * MARGIN)

    shapes = []
    for tick in range(6):
        height, step = y(tick / 5 * top), tick / 5 * last / seconds
        below = f'x="{x(step):.1f}" y="{HEIGHT - MARGIN + 18}" text-anchor="middle"'
        shapes += [
            f'<line x1="{MARGIN}" y1="{height:.1f}" x2="{WIDTH - MARGIN}" y2="{height:.1f}" stroke="#ddd"/>',
            f'<text x="{MARGIN - 8}" y="{height + 4:.1f}" text-anchor="end">{tick / 5 * top:.0f}</text>',
            f"<text {below}>{tick / 5 * last:.0f}</text>",
        ]
    shapes.append(f'<text x="{WIDTH / 2}" y="{HEIGHT - 12}" text-anchor="middle">time, s</text>')
    shapes.append(f'<text x="{MARGIN - 40}" y="{MARGIN - 30}">distance, m</text>')
    shapes += marks(next(iter(walks.values())), x)
    for colour, (label, line) in zip(COLOURS, lines.items(), strict=False):
        points = " ".join(f"{x(step):.1f},{y(metres):.1f}" for step, metres in enumerate(line))
        shapes.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>')
        place = f'x="{x(len(line) - 1):.1f}" y="{y(line[-1]) + 52:.1f}" text-anchor="end"'
        shapes.append(f'<text {place} fill="{colour}">{label}</text>')
    return document(WIDTH, HEIGHT, shapes)


def marks(walk: list[Row], x: Callable[[float], float]) -> list[str]:
    """Draw the onset of the damage and what the controller did."""
    found = [next(step for step, row in enumerate(walk) if row["damage"] != "healthy")]
    texts = [f"damage: {walk[-1]['damage']}"]
    for event, text in MARKS.items():
        for step, row in enumerate(walk):
            if event in row["event"].split("; "):
                found.append(step)
                texts.append(f"{text}: {row['assumed']}" if event == "adapted" else text)
    shapes = []
    for number, (step, text) in enumerate(zip(found, texts, strict=True)):
        shapes += [
            f'<line x1="{x(step):.1f}" y1="{MARGIN - 24}" x2="{x(step):.1f}" y2="{HEIGHT - MARGIN}" '
            'stroke="#777" stroke-dasharray="4 3"/>',
            f'<text x="{x(step) + 4:.1f}" y="{MARGIN - 14 + 18 * number}" fill="#555">{text}</text>',
        ]
    return shapes


if __name__ == "__main__":
    main()
