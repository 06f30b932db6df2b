"""What stands on the map, drawn as small pictures of one cell, and the colours of it all."""

import math
from collections.abc import Sequence
from functools import lru_cache

from PIL import Image, ImageChops, ImageDraw, ImageFilter

_COLOURS = """
backdrop #DCE6E6, shadow #33474E, card #FDFCF8, rail #E7EBE5, tint #F1F4EE, ink #24343B, muted #78878B, white #FFFFFF,
good #55A27A, fair #E3A94B, low #DB6058, flight #6C83C6, trail #4C63B6, target #E0525F, barred #C65B55, shade #24343B30,
lawn #CFDEBB, shrub #B4CB9E, kerb #DDD8C6, street #F7F4EA, marking #DCD5C2, plot #EAE3D5, plot_edge #D6CDBA,
window #F6E7BE, glass #CFE3EA, metal #EEF0EE, metal_dark #A9B4B8, roof0 #D4886B, roof1 #7F9CB0, roof2 #E0BC84,
roof3 #8FB0A4, roof4 #B796A8, roof5 #C9775F, park #BCD3A1, leaf0 #74AA76, leaf1 #88B26C, barrier #E8824A, plank #FFF8EC,
lamp #F7C65B, box #DDB07C, front #C4915D, edge #A87747, tape #F3DDB5, label #FBF6EA, drop #FFFDF6, drop_edge #E3C39A,
done #4E9F74, done_pale #DCEBD8, done_edge #B5D5BC, charger #4F9AA8, charger_edge #3A7E8D, bolt #FFE08A, hull #2E3D4D,
hull_light #53687E, rotor #E4EFF6C8, rotor_rim #4C6075D0, blade #2E3D4D90
"""
PALETTE = {pair.split()[0]: pair.split()[1] for pair in _COLOURS.split(",")}
# Figures around the middle of a cell, in hundredths of a cell: shape, colour, numbers. `4` before a shape repeats it in
# four quarter turns. `lift` and `cast` (reach, blur, strength in percent, steps) put the shadow of all since the last
# of these words below it, `cast` the shadow alone. `+20` after a colour mixes it with 20 % white, `-20` with black.
_FIGURES = """\
building: box plot_edge -46 -46 46 46 9; box plot -44 -44 44 44 8; lift 0 0 0 1; box roof-32 -33 -40 33 36 3;
  box window -27 26 -21 32 1; box window -15 26 -9 32 1; box window -3 26 3 32 1; box window 9 26 15 32 1;
  box window 21 26 27 32 1; lift 17 2 32 6; box roof+28 -33 -40 33 23 3; box roof -29 -36 29 19 2
top0: poly roof+14 -29 -36 29 -36 12 -8 -12 -8; poly roof-12 -29 19 29 19 12 -8 -12 -8; box roof-35 6 -28 14 -18 1;
  poly roof-5 29 -36 29 19 12 -8; line roof+30 3 -12 -8 12 -8
top1: box roof-14 -29 -36 29 -30 0; box roof-22 -20 -20 -2 -6 2; box metal -22 -22 -4 -8 2;
  oval metal_dark -13 -15 5; box roof-22 4 -20 22 -6 2; box metal 2 -22 20 -8 2; oval metal_dark 11 -15 5;
  box roof-22 -22 2 -6 12 2; box roof+20 8 0 22 12 2
top2: box roof-10 -25 -31 25 14 3; box park -21 -27 2 10 3; oval leaf0 -13 -18 6; oval leaf0 -7 -4 5;
  oval leaf0 -15 3 5; box glass 7 -25 21 -16 1; box glass 7 -12 21 -3 1; box glass 7 1 21 10 1
top3: box roof-28 -16 -22 24 15 2; box roof+32 -21 -29 18 8 2; box roof+12 -18 -26 15 5 2; oval roof-18 -1 -10 10;
  oval metal -2 -11 9; oval metal_dark -2 -11 4
tree0: oval park 0 0 46; lift 0 0 0 1; crown leaf0 -13 -12 23; crown leaf1 17 4 19; crown leaf0 -8 21 16; lift 11 2 30 5
tree1: oval park 0 0 46; lift 0 0 0 1; crown leaf1 0 -2 33; lift 11 2 30 5
tree2: oval park 0 0 46; lift 0 0 0 1; crown leaf0 12 -14 22; crown leaf0 -18 0 18; crown leaf1 10 20 17; lift 11 2 30 5
tree3: oval park 0 0 46; lift 0 0 0 1; crown leaf0 -12 5 26; crown leaf1 19 -13 17; crown leaf1 20 20 12; lift 11 2 30 5
obstacle: line hull_light 5 -29 30 -25 -20 -21 30; line hull_light 5 21 30 25 -20 29 30; box plank -41 -22 41 -3 3;
  poly barrier -28 -22 -17 -22 -26 -3 -37 -3; poly barrier -9 -22 2 -22 -7 -3 -18 -3;
  poly barrier 10 -22 21 -22 12 -3 1 -3; poly barrier 29 -22 40 -22 31 -3 20 -3; box plank -41 4 41 23 3;
  poly barrier -28 4 -17 4 -26 23 -37 23; poly barrier -9 4 2 4 -7 23 -18 23; poly barrier 10 4 21 4 12 23 1 23;
  poly barrier 29 4 40 4 31 23 20 23; box shade -41 -6 41 -3 1; box shade -41 20 41 23 1; oval lamp-25 -25 -28 8;
  oval lamp -26 -29 6; oval lamp-25 25 -28 8; oval lamp 24 -29 6; lift 9 2 34 5
pad: box charger_edge -42 -42 42 42 14; box charger -38 -38 38 38 11; ring white 0 0 31 3;
  poly bolt 6 -25 -15 4 -2 4 -7 25 15 -6 2 -6
parcel: oval drop_edge 0 0 43; oval drop 0 0 39; lift 0 0 0 1; box edge -28 -30 28 30 4; box box -26 -28 26 8 2;
  box front -26 8 26 28 2; box tape -6 -28 6 8 0; box tape-12 -6 8 6 17 0; box label 10 13 22 23 1;
  box edge+40 12 15 20 16 0; box edge+40 12 18 18 19 0; lift 12 2 34 5
delivered: oval done_edge 0 0 43; oval done_pale 0 0 39; line white 17 -17 2 -5 14 19 -13;
  line done 11 -17 2 -5 14 19 -13
start: ring trail+45 0 0 24 5; oval trail+45 0 0 9
target: ring white 0 0 52 14; ring target 0 0 52 9; 4 line white 11 0 -64 0 -44; 4 line target 7 0 -64 0 -43
no_entry: 4 line barred 5 -45 -45 45 -45; oval white 34 -34 17; oval barred 34 -34 14; box white 26 -37 42 -31 1
drone: 4 line hull 8 0 0 30 30; 4 oval hull 30 30 21; box hull -16 -22 16 22 8; cast 24 5 34 1; 4 oval rotor 30 30 23;
  4 line blade 5 17 24 43 36; 4 ring rotor_rim 30 30 23 3; 4 line hull 9 0 0 30 30; 4 oval hull_light 30 30 6;
  oval target -30 30 6; oval target 30 30 6; box hull -17 -23 17 23 9; box hull_light -12 -9 12 17 6;
  oval glass 0 -13 6; oval hull 0 -13 3; box drop -6 -1 6 9 2
"""
_DRAWN = {name: art for name, _, art in (line.partition(": ") for line in _FIGURES.replace("\n  ", " ").splitlines())}
FIGURES = _DRAWN | {
    f"building{i}": f"{_DRAWN['building']}; {_DRAWN[f'top{i % 4}']}".replace("roof", f"roof{i // 4}") for i in range(24)
}
CROWN = (
    (0, 0, 1, "-18"),
    (-0.09, -0.12, 0.86, ""),
    (-0.30, -0.34, 0.36, "+24"),
    (0.52, 0.22, 0.11, "-18"),
    (0.04, 0.56, 0.11, "-18"),
    (-0.51, 0.24, 0.11, "-18"),
    (0.31, -0.47, 0.11, "-18"),
)
"""A tree's crown from above: offset and radius as shares of its own radius, and tone."""
Point = tuple[float, float]


def around(at: Point, across: float, down: float = 0.0) -> tuple[float, float, float, float]:
    """The box around a point: left, top, right, bottom in pixels."""
    return at[0] - across, at[1] - (down or across), at[0] + across, at[1] + (down or across)


def stroke(pen: ImageDraw.ImageDraw, points: Sequence[Point], width: float, colour: str | int) -> None:
    """A line with round ends and joints."""
    wide = max(1, round(width))
    pen.line(points, fill=colour, width=wide)
    for at in points:
        pen.ellipse(around(at, (wide - 1) / 2), fill=colour)


def colour(name: str) -> str:
    """A colour of the palette as #RRGGBB; `+20` after the name mixes it with 20 % white, `-20` with black."""
    base, _, percent = name.replace("-", "+-").partition("+")
    mix = int(percent or 0) / 100
    return "#" + "".join(f"{round(p + (255 * (mix > 0) - p) * abs(mix)):02X}" for p in bytes.fromhex(PALETTE[base][1:]))


@lru_cache(maxsize=256)
def draw_figure(name: str, cell: int) -> Image.Image:
    """A figure for cells of a size, drawn larger and then reduced for smooth edges. Shared: do not draw on it."""
    fine = 4 if cell <= 100 else 2
    unit, side = cell * fine / 100, (cell + 2 * math.ceil(0.4 * cell)) * fine
    below, layer = Image.new("RGBA", (side, side)), Image.new("RGBA", (side, side))
    for item in FIGURES[name].split("; "):
        shape, *words = item.removeprefix("4 ").split()
        if shape in ("lift", "cast"):
            below.alpha_composite(_shadow(layer, unit, *map(int, words)))
            if shape == "lift":
                below.alpha_composite(layer)
            layer = Image.new("RGBA", (side, side))
            continue
        glaze = Image.new("RGBA", (side, side))  # as Pillow replaces what lies under translucent colours
        _trace(ImageDraw.Draw(glaze), shape, words[0], [int(word) * unit for word in words[1:]], side / 2)
        for turn in range(4 if item.startswith("4 ") else 1):
            layer.alpha_composite(glaze.rotate(90 * turn))
    below.alpha_composite(layer)
    return below.reduce(fine)


def _shadow(layer: Image.Image, unit: float, reach: int, blur: int, strength: int, steps: int) -> Image.Image:
    alpha, cast = layer.getchannel("A"), Image.new("L", layer.size)
    for offset in (reach * unit * step / steps for step in range(1, steps + 1)):
        cast = ImageChops.lighter(cast, ImageChops.offset(alpha, round(0.7 * offset), round(offset)))
    shadow = Image.new("RGBA", alpha.size, PALETTE["shadow"])
    shadow.putalpha(cast.filter(ImageFilter.GaussianBlur(blur * unit)).point([i * strength // 100 for i in range(256)]))
    return shadow


def _trace(pen: ImageDraw.ImageDraw, shape: str, name: str, numbers: list[float], middle: float) -> None:
    """Draw one shape; `numbers` are pixels from the middle."""
    places, paint = [middle + number for number in numbers], colour(name)
    if shape == "crown":
        for dx, dy, share, tone in CROWN:
            at = places[0] + dx * numbers[2], places[1] + dy * numbers[2]
            pen.ellipse(around(at, share * numbers[2]), fill=colour(name + tone))
    elif shape == "oval":
        pen.ellipse(around((places[0], places[1]), numbers[2]), fill=paint)
    elif shape == "ring":
        pen.arc(around((places[0], places[1]), numbers[2] + numbers[3] / 2), 0, 360, paint, round(numbers[3]) or 1)
    elif shape == "box":
        radius = min(numbers[4], (numbers[2] - numbers[0]) / 2 - 2, (numbers[3] - numbers[1]) / 2 - 2)
        bend = radius > 0
        pen.rounded_rectangle(places[:4], radius, paint, corners=(bend, bend, bend, bend))
    elif shape == "poly":
        pen.polygon(places, fill=paint)
    else:
        stroke(pen, list(zip(places[1::2], places[2::2], strict=True)), numbers[0], paint)
