"""Draw the first paint of the page: a map with a recorded flight that moves before any script has run.

    python -m tools.first_paint

The tool reads the record `first_paint.json`, a flight of the tour network over map 43 of skyline_medium, and writes
`first_paint.html`, `css/hello-motion.css`, and `preview.png` for sites that preview links. Of the first 100 maps of
hard and skyline_medium this is the one on which greedy loses most, 75 points of 95, since its battery is empty after
one parcel of four. The network scores the optimum.
"""

import re
from html import escape
from itertools import pairwise
from pathlib import Path
from zlib import crc32

import numpy as np

from drone_env.core.actions import Event
from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.envs.rendering import save_picture
from drone_env.planning.optimal import solve
from drone_env.results.record import EpisodeRecord, replay
from drone_env.server.page_files import ART, PAGE
from drone_env.server.pilots import HUMAN, OURS

FIRST_FLIGHT = f"?task=skyline_easy&seed=152&pilot={HUMAN}"
"""A visitor's first map. Greedy delivers two of three parcels there, and a best flight takes 15 steps. Of the first 200
maps that greedy fails, it forgives most: a cautious pilot of whose moves 15 % are random delivers all in 92 %."""
PILOT = "tournet"
"""The pilot of the recorded flight."""
OVER_HELSINKI = f"?task=city_small&seed=29&pilot={HUMAN}"
"""No parcel is so near the start that the drone hides it on a phone."""
RIVALS = (HUMAN, PILOT, "greedy")
SECOND, PAUSE = 4, 8
"""Steps per second, and the pause at the end in steps."""
UNIT = 100
"""The side of a cell in the picture, as on the sheet of figures."""
FIELD = 180
"""The side of a figure on the sheet."""
VARIETY = {Cell.BUILDING: 4, Cell.TREE: 4}
"""Number of figures of a kind on the map; each additional one makes the page larger."""


def read_flight() -> Episode:
    """The recorded flight."""
    return replay(EpisodeRecord.read((PAGE / "first_paint.json").read_bytes(), "first_paint.json is not a record"))


def draw() -> dict[Path, str]:
    """The files of the page that show the recorded flight, and what they contain."""
    episode = read_flight()
    return {
        PAGE / "first_paint.html": _section(episode) + "\n",
        PAGE / "css" / "hello-motion.css": _motion(episode),
    }


def _section(episode: Episode) -> str:
    task, seed = episode.task.short_name, episode.seed
    race = f"?task={task}&seed={seed}&pilots={','.join(RIVALS)}"
    optimum = solve(task, seed).score
    score = f"scored {100 * episode.score:.1f} of {100 * optimum:.1f} possible."
    who = f"{OURS[PILOT].name}, a trained network,"
    where = f'data-task="{task}" data-seed="{seed}"'
    return f"""<section id="hello" class="hello" aria-labelledby="hello-title" {where}>
<div class="hello-words">
<h2 id="hello-title">Deliver all parcels before the battery is empty. {who} {score}</h2>
<p class="hello-actions"><a class="button primary" href="{escape(FIRST_FLIGHT)}">Fly it yourself</a>
<a class="button" href="{escape(race)}">Race the network</a>
<!-- today -->
<a class="button" href="{escape(OVER_HELSINKI)}">Fly over Helsinki</a></p>
</div>
{_picture(episode)}
</section>"""


def _picture(flown: Episode) -> str:
    """The map and the path of a flight as inline SVG. The content security policy forbids inline styles."""
    start, task = Episode(flown.task, seed=flown.seed), flown.task
    grid = start.grid()
    grid[start.position[::-1]] = start.under
    city = [
        _use(_figure(Cell(kind), x, y), x, y)
        for (y, x), kind in np.ndenumerate(grid)
        if kind not in (Cell.ROAD, Cell.DELIVERY)
    ]
    parcels = [
        _use(name, x, y, f"hello-{name} hello-{name}{number}")
        for number, (x, y, _) in enumerate(start.parcels)
        for name in ("parcel", "delivered")
    ]
    wide, high = task.width * UNIT, task.height * UNIT
    lines = [f"M{at} 0V{high}" for at in range(UNIT, wide, UNIT)] + [
        f"M0 {at}H{wide}" for at in range(UNIT, high, UNIT)
    ]
    way = " ".join(f"{x},{y}" for x, y in _way(flown))
    length = sum(move != (0, 0) for move in _moves(_way(flown)))
    drone = _use("drone", *start.position, "hello-drone")
    drawn = [*city, *parcels, drone]
    figures = _figures({name for use in drawn for name in re.findall(r'#hello-(\w+)"', use)})
    return f"""<svg class="hello-map" viewBox="-20 -20 {wide + 40} {high + 40}" role="img" \
aria-label="A drone flies over a city and delivers {task.deliveries} parcels">
<defs>{figures}</defs>
<rect class="hello-ground" width="{wide}" height="{high}" rx="12"/><path class="hello-grid" d="{"".join(lines)}"/>
{"".join(city)}<rect class="hello-night" width="{wide}" height="{high}" rx="12"/>
<polyline class="hello-way" points="{way}" pathLength="{length}"/>
{"".join(parcels)}{drone}
</svg>"""


def _figures(names: set[str]) -> str:
    """Figures of the sheet as symbols, with their shadows."""
    sheet = (ART / "figures.svg").read_text(encoding="utf-8")
    shadows = re.findall("<filter .*?</filter>", sheet)
    found = dict(re.findall(r'<svg id="(\w+)".*?>(.*?)</svg>', sheet, re.DOTALL))
    box = f'viewBox="{-FIELD / 2:g} {-FIELD / 2:g} {FIELD} {FIELD}"'
    symbols = [f'<symbol id="hello-{name}" {box}>{found[name]}</symbol>' for name in sorted(names)]
    return re.sub(r">\s+<", "><", "".join([*shadows, *symbols]))


def _figure(kind: Cell, x: int, y: int) -> str:
    """The name of a figure. A building has several."""
    several = VARIETY.get(kind)
    return f"{CELL_KINDS[kind].name}{'' if several is None else crc32(bytes((x, y))) % several}"


def _use(figure: str, x: int, y: int, names: str = "") -> str:
    """A figure in a cell. A transform places moving figures, and a style replaces it."""
    left, top = x * UNIT + (UNIT - FIELD) // 2, y * UNIT + (UNIT - FIELD) // 2
    at = f'class="{names}" ' if names else ""
    return f'<use {at}href="#hello-{figure}" x="{left}" y="{top}" width="{FIELD}" height="{FIELD}"/>'


def _way(flown: Episode) -> list[tuple[int, int]]:
    """The middle of the drone's cell at the start and after each step."""
    start = Episode(flown.task, seed=flown.seed).position
    cells = [start, *((step.x, step.y) for step in flown.path)]
    return [(x * UNIT + UNIT // 2, y * UNIT + UNIT // 2) for x, y in cells]


def _moves(way: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The displacement of the drone in each step: right and down."""
    return [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(way)]


def _motion(flown: Episode) -> str:
    """Keyframes for the steps of the flight, unless the visitor prefers reduced motion."""
    way, whole = _way(flown), flown.steps + PAUSE
    moves = _moves(way)
    turns = [0, *(step for step in range(1, flown.steps) if moves[step] != moves[step - 1]), flown.steps]

    def at(step: int) -> str:
        share = f"{100 * step / whole:.2f}%"
        return f"{share},100%" if step == flown.steps else share

    def ahead(step: int) -> int:
        return sum(move != (0, 0) for move in moves[step:])

    frames = {
        "drone": [
            f"{at(n)}{{transform:translate({way[n][0] - way[0][0]}px,{way[n][1] - way[0][1]}px)}}" for n in turns
        ],
        "way": [f"{at(n)}{{stroke-dashoffset:{ahead(n)}}}" for n in turns],
    }
    for number, (x, y, _) in enumerate(flown.parcels):
        delivered = next(
            step for step, flew in enumerate(flown.path, 1) if (flew.event, flew.x, flew.y) == (Event.DELIVERY, x, y)
        )
        frames[f"parcel{number}"] = ["0%{opacity:1}", f"{at(delivered)}{{opacity:0}}"]
        frames[f"delivered{number}"] = ["0%{opacity:0}", f"{at(delivered)}{{opacity:1}}"]
    rules = [f".hello-way{{stroke-dasharray:{ahead(0)}}}"]
    for name, steps in frames.items():
        pace = "linear" if name in ("drone", "way") else "step-end"
        rules.append(f".hello-{name}{{animation:hello-{name} {whole / SECOND:g}s {pace} infinite}}")
        rules.append(f"@keyframes hello-{name}{{{''.join(steps)}}}")
    return "\n".join(["@media (prefers-reduced-motion: no-preference) {", *rules, "}\n"])


if __name__ == "__main__":
    save_picture(read_flight(), PAGE / "preview.png", 630)
    for path, text in draw().items():
        path.write_text(text, encoding="utf-8")
