"""Draw learning curves as SVG.

A line is the mean over the runs of a learner, its band reaches from the lowest to the highest run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean

WIDTH, HEIGHT, MARGIN = 640, 360, 56
COLOURS = ("#0b6e99", "#c2571a", "#4f7d2a", "#7d4f99")
DARK = {
    **dict(zip(COLOURS, ("#5ab4dd", "#f0975e", "#9ac774", "#c59ae0"), strict=True)),
    "white": "#14181d",
    "#ddd": "#3a424b",
    "#777": "#9198a1",
    "#555": "#b3bac2",
}
"""What replaces the colours where the reader prefers dark pages."""

Curve = Sequence[Mapping[str, float]]
"""Points of one run, each with ``forward_reward`` and the quantity along the axis."""


@dataclass(frozen=True)
class Across:
    """What the curves run over."""

    key: str
    label: str
    tick: str
    unit: float


ENV_STEPS = Across("env_steps", "env steps", "{:.1f} M", 1e6)
MINUTES = Across("seconds", "minutes of rollout and update", "{:.0f}", 60)


def picture(learners: Mapping[str, Sequence[Curve]], across: Across) -> str:
    """Draw the curves of each learner's runs; those of one learner end with the shortest."""
    points = [point for curves in learners.values() for curve in curves for point in curve]
    last = max(point[across.key] for point in points)
    scale = Scale(last, round_up(max(point["forward_reward"] for point in points)))
    shapes = [axes(scale, across)]
    for line, (colour, (name, curves)) in enumerate(zip(COLOURS, learners.items(), strict=False)):
        spans = list(zip(*curves, strict=False))
        values = [[point["forward_reward"] for point in span] for span in spans]
        places = [span[0][across.key] for span in spans]
        band = [*zip(places, map(max, values), strict=True)]
        band += reversed([*zip(places, map(min, values), strict=True)])
        shapes.append(f'<polygon points="{scale.path(band)}" fill="{colour}" opacity="0.2"/>')
        middle = zip(places, map(mean, values), strict=True)
        shapes.append(
            f'<polyline points="{scale.path(middle)}" fill="none" stroke="{colour}" stroke-width="2"/>'
        )
        label = f"{name}, {len(curves)} seed{'s' if len(curves) > 1 else ''}"
        shapes.append(f'<text x="{MARGIN + 12}" y="{MARGIN + 18 * line}" fill="{colour}">{label}</text>')
    return document(WIDTH, HEIGHT, shapes)


def document(width: int, height: int, shapes: Iterable[str]) -> str:
    """Put shapes on an opaque background, light or dark, so that every page shows them well."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}"'
    rules = [f'[{of}="{light}"]{{{of}:{dark}}}' for light, dark in DARK.items() for of in ("fill", "stroke")]
    style = f"<style>@media (prefers-color-scheme:dark){{text{{fill:#e6e6e6}}{''.join(rules)}}}</style>"
    back = '<rect width="100%" height="100%" fill="white"/>'
    font = 'font-family="sans-serif" font-size="15">'
    return "\n".join([f"{head} {font}{style}{back}", *shapes, "</svg>\n"])


@dataclass(frozen=True)
class Scale:
    """From data to pixels."""

    x_max: float
    y_max: float

    def x(self, place: float) -> float:
        """Return the abscissa of a place along the axis."""
        return MARGIN + place / self.x_max * (WIDTH - 2 * MARGIN)

    def y(self, reward: float) -> float:
        """Return the ordinate of a forward reward; negative ones lie on the axis."""
        return HEIGHT - MARGIN - max(reward, 0.0) / self.y_max * (HEIGHT - 2 * MARGIN)

    def path(self, points: Iterable[tuple[float, float]]) -> str:
        """Return the points of a line."""
        return " ".join(f"{self.x(place):.1f},{self.y(reward):.1f}" for place, reward in points)


def round_up(value: float) -> float:
    """Return the next multiple of 100."""
    return -(-value // 100) * 100


def axes(scale: Scale, across: Across) -> str:
    """Draw axes with five ticks each."""
    shapes = []
    for tick in range(6):
        place, reward = tick / 5 * scale.x_max, tick / 5 * scale.y_max
        x, y = scale.x(place), scale.y(reward)
        shapes += [
            f'<line x1="{MARGIN}" y1="{y:.1f}" x2="{WIDTH - MARGIN}" y2="{y:.1f}" stroke="#ddd"/>',
            f'<text x="{MARGIN - 8}" y="{y + 4:.1f}" text-anchor="end">{reward:.0f}</text>',
            f'<text x="{x:.1f}" y="{HEIGHT - MARGIN + 18}" text-anchor="middle">'
            f"{across.tick.format(place / across.unit)}</text>",
        ]
    shapes.append(f'<text x="{WIDTH / 2}" y="{HEIGHT - 12}" text-anchor="middle">{across.label}</text>')
    title = "forward reward of an episode, m/s summed over steps"
    shapes.append(f'<text x="{MARGIN - 40}" y="{MARGIN - 20}">{title}</text>')
    return "\n".join(shapes)
