"""Residual map: where in the workspace the model is wrong, and in which direction.

The arrows of :mod:`.residual_arrows`, as figures that a reader moves and chooses rows in, and as SVG, for who runs no
scripts.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from bokeh.models import Circle, ColumnDataSource, FixedTicker, LinearColorMapper, Range1d, Segment, Text
from numpy.typing import NDArray

from ..base.figures import listed
from ..base.types import Floats
from ..errors import SherkitError
from ..model.effect import Effect
from ..model.kinds import Robot, kind_of, known_kinds
from .picture import (
    DIVERGING,
    FONT,
    FONT_SIZE,
    INK,
    LETTERS,
    MUTED,
    RULE,
    SEQUENTIAL,
    Picture,
    Table,
    Tables,
    colour_bar,
    figure,
    hover,
    number,
    quantity,
    sources_of,
)
from .residual_arrows import MOMENTS, Change, Sheet, cut, note, round_number, shown
from .residuals import Residuals

_NARROWEST = 220
#: Panels narrower than this have smaller points and fewer ticks: one for so much, px.
_WIDE, _TICK = 280, 60
#: What the axis of a panel takes of its width, px.
_AROUND = 55
#: Between panels of an SVG, and the line below them, px.
_GAP, _CAPTION = 24, 30


def residual_map(
    change: Change, *, planes_across: bool = False, width_px: int = 870, alone: bool = False
) -> Picture[Change]:
    """Arrows of the error, before and after side by side on one scale, a row of panels for each plane.

    ``planes_across`` puts planes side by side instead, before above after, with one axis for each row, of which there
    are more where panels would be narrow: wider and less high. ``width_px`` is that of all panels together. Where the
    run moved along one coordinate only, arrows stand along a line. ``alone`` draws what is left after, with nothing
    beside it.
    """
    panels = cut(change.before)
    count = len(panels.names)
    moments = MOMENTS[1:] if alone else MOMENTS
    planes_across = planes_across and count > 1
    columns = 2
    if planes_across:
        most = max((width_px - _AROUND) // (_NARROWEST - _AROUND), 1)
        columns = -(-count // -(-count // most))
        width = (width_px - _AROUND) // columns
    else:
        width = max(width_px // columns, _NARROWEST) - _AROUND
    sheet = Sheet(change, width, panels)

    def tables(state: Change) -> Tables:
        every = sheet.tables(state)
        return {name: table for name, table in every.items() if name.partition("_")[0] in moments}

    sources = sources_of(tables(change))
    mappers = {m: LinearColorMapper(palette=DIVERGING) for m in MOMENTS}
    order = [(moment, k) for k in range(count) for moment in moments]
    if planes_across:
        order.sort(key=lambda one: one[0] == "after")
    ranges = Range1d(*sheet.ranges[0]), Range1d(*sheet.ranges[1])
    figures = [_panel(sources, k, moment, sheet, mappers[moment], ranges) for moment, k in order]
    tickers = {m: FixedTicker() for m in MOMENTS}
    if planes_across:
        for made, (_, k) in zip(figures, order, strict=True):
            made.yaxis.visible = panels.up is not None and k % columns == 0
    named = []
    if len(change.before.names) != 2:
        # beside what is always seen; where rows of panels are moments, each has its own
        last = min(columns, len(figures)) - 1
        at = {moment: count * place + last for place, moment in enumerate(moments)}
        ends = at if planes_across else {"after": last}
        named = [colour_bar(figures[k], mappers[m], "", ticker=tickers[m]) for m, k in ends.items()]

    def colour(state: Change) -> None:
        for moment, mapper in mappers.items():
            high = sheet.colours[moment]
            mapper.low, mapper.high = -high, high
            tickers[moment].ticks = [-high, 0.0, high]
        left = shown(state)[0]
        for title in named:
            title.text = f"{left.names[2 if len(left.names) > 2 else 0]}, {left.unit}"

    colour(change)

    def tune(state: Change) -> None:
        nonlocal sheet
        sheet = Sheet(state, width, panels)
        colour(state)
        for one, new in zip(ranges, sheet.ranges, strict=True):
            one.start, one.end = new
        for made in figures:
            made.frame_height = sheet.height_px

    before = [one for one, (moment, _) in zip(figures, order, strict=True) if moment == "before"]
    if planes_across:
        # moments begin with rows of their own
        figures = [
            one
            for k in range(0, len(figures), count)
            for one in (*figures[k : k + count], *[None] * (-count % columns))
        ]
    return Picture.of("residual_map", figures, sources, tables, tune, note=note(change), columns=columns, before=before)


def _panel(
    sources: dict[str, ColumnDataSource], k: int, moment: str, sheet: Sheet, mapper: LinearColorMapper,
    ranges: tuple[Range1d, Range1d],
) -> Any:  # fmt: skip
    source, key = sources[f"{moment}_{k}"], sources[f"{moment}_{k}_key"]
    panels, left, width = sheet.panels, sheet.change.before, sheet.width
    made = figure(
        quantity(panels.across), quantity(panels.up) if panels.up else None, frame_width=width,
        frame_height=sheet.height_px, x_range=ranges[0], y_range=ranges[1],
        tools="pan,box_zoom,wheel_zoom,box_select,lasso_select,tap,reset",
    )  # fmt: skip
    made.yaxis.visible = panels.up is not None
    if width <= _WIDE:
        made.xaxis[0].ticker.desired_num_ticks = max(width // _TICK, 2)
    colour = {"field": "colour", "transform": mapper}
    made.segment("x", "y", "x1", "y1", source=source, color=colour, line_width=2.5, nonselection_line_alpha=0.15)
    # the tail is where the pose is; its head has the arrow's colour
    tail = made.scatter("x", "y", source=source, size=4 if width > _WIDE else 3, color=INK, nonselection_alpha=0.2)
    made.scatter("x1", "y1", source=source, size=6 if width > _WIDE else 4, color=colour, nonselection_alpha=0.15)
    # glyphs that nobody selects: a figure's own methods make four more of each
    title = Text(x="title_x", y="title_y", text="title", text_baseline="top", text_font_style="bold", **LETTERS)
    bar = Text(x="bar_text_x", y="bar_text_y", text="bar_text", text_align="right", text_baseline="bottom", **LETTERS)
    noise = Text(x="noise_text_x", y="noise_y", text="noise_text", text_baseline="middle", **LETTERS)
    circle = Circle(x="noise_x", y="noise_y", radius="noise_r", fill_color=None, line_color=MUTED, line_width=1.5)
    line = Segment(x0="bar_x0", y0="bar_y", x1="bar_x1", y1="bar_y", line_color=INK, line_width=3)
    for glyph in (title, line, bar, circle, noise):
        made.add_glyph(key, glyph)
    columns = ("ex", "ey", "ez") if len(left.names) > 1 else ("ey",)
    reading = [(name, f"@{column}{{0.0}} {left.unit}") for name, column in zip(left.names, columns, strict=False)]
    places = [(quantity(panels.across), "@x{0.00}")] + ([(quantity(panels.up), "@y{0.00}")] if panels.up else [])
    made.add_tools(hover([tail], *places, *reading, ("readings", "@n"), (f"{left.counted}s", "@lines")))
    return made


# -- As SVG -----------------------------------------------------------------------------------------------------------


def still(*changes: Change, caption: str = "", width_px: int = 290) -> str:
    """The same arrows as SVG: moments beside one another, a row of panels for each plane. Text is escaped.

    A change whose moments are the same is drawn once; several changes stand beside one another.
    """
    sheets = [Sheet(change, width_px) for change in changes]
    columns = [
        [_still_panel(sheet, tables, moment, k) for k in range(len(sheet.panels.names))]
        for sheet in sheets
        for tables in [sheet.tables(sheet.change)]
        for moment in MOMENTS[sheet.change.before is sheet.change.after :]
    ]
    if len(columns) == 1:
        columns = [[one] for one in columns[0]]
    wide, high = width_px + _GAP, max(one.height_px for one in sheets) + _GAP
    width, bottom = _GAP + wide * len(columns), high * max(map(len, columns)) + _CAPTION
    placed = "\n".join(
        f'<g transform="translate({_GAP + wide * across} {_GAP + high * down})">{panel}</g>'
        for across, column in enumerate(columns)
        for down, panel in enumerate(column)
    )
    names = changes[0].before.names
    colour = f"; blue: {names[2]} lower, orange: higher" if len(names) > 2 else ""
    said = f"{caption} Arrows: {' and '.join(names[:2])}{colour}.".strip()
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {bottom + _GAP // 2}" width="{width}" '
        f'style="max-width:100%;height:auto" font-family="{FONT}" font-size="{FONT_SIZE}" fill="{INK}" '
        f'stroke-linecap="round">\n'
        f'<rect width="{width}" height="{bottom + _GAP // 2}" fill="#fff"/>\n{placed}\n'
        f'<text x="{_GAP}" y="{bottom}" font-size="14">{escape(said)}</text>\n</svg>\n'
    )


def _still_panel(sheet: Sheet, tables: Tables, moment: str, k: int) -> str:
    """One panel: a path for the arrows of each colour, one for all poses."""
    arrows, key = tables[f"{moment}_{k}"], tables[f"{moment}_{k}_key"]
    x0, y1 = sheet.ranges[0][0], sheet.ranges[1][1]

    def at(table: Table, x: str, y: str) -> list[str]:
        across, down = (np.asarray(table[x]) - x0) / sheet.pixel, (y1 - np.asarray(table[y])) / sheet.pixel
        return [f"{a:.1f} {b:.1f}" for a, b in zip(across, down, strict=True)]

    def words(text: str, x: str, y: str, more: str) -> str:
        return f'<text transform="translate({at(key, x, y)[0]})"{more}>{escape(text)}</text>'

    tails, heads = at(arrows, "x", "y"), at(arrows, "x1", "y1")
    part = 0.5 * np.asarray(arrows["colour"]) / sheet.colours[moment] + 0.5
    drawn: dict[str, str] = {}
    for tail, head, shade in zip(tails, heads, np.clip(part, 0, 1) * (len(DIVERGING) - 1), strict=True):
        colour = DIVERGING[round(shade)]
        drawn[colour] = f"{drawn.get(colour, '')}M{tail}L{head}"
    titles = enumerate(key["title"][0].split("\n"))
    ((bar,), (end,)), (circle,) = (at(key, x, "bar_y") for x in ("bar_x0", "bar_x1")), at(key, "noise_x", "noise_y")
    return (
        f'<rect width="{sheet.width}" height="{sheet.height_px}" fill="none" stroke="{RULE}"/>'
        f'<g fill="none" stroke-width="2.5">'
        + "".join(f'<path stroke="{colour}" d="{path}"/>' for colour, path in drawn.items())
        + f'<path stroke="{INK}" stroke-width="3.5" d="{"".join(f"M{tail}h0" for tail in tails)}"/>'
        f'<path stroke="{INK}" d="M{bar}L{end}"/>'
        f'<circle transform="translate({circle})" r="{key["noise_r"][0] / sheet.pixel:.1f}" stroke="{MUTED}"/></g>'
        + "".join(
            words(line, "title_x", "title_y", f' dy="{0.8 + 1.2 * k:g}em" font-weight="bold"') for k, line in titles
        )
        + words(key["bar_text"][0], "bar_text_x", "bar_text_y", ' text-anchor="end"')
        + words(key["noise_text"][0], "noise_text_x", "noise_y", ' dy="0.35em"')
    )


def signature_map(effect: Effect, robot: Robot) -> str:
    """What an effect of plausible size leaves on a robot after the geometry has had its say, as SVG, a panel for each
    height. Raises :class:`~sherkit.errors.SherkitError` where it has none."""
    signature = kind_of(robot).signature
    if signature is None:
        drawn = [name for name, kind in known_kinds().items() if kind.signature is not None]
        raise SherkitError(
            f"--picture draws on a {listed(drawn)} alone; a report shows the maps of all effects on a run"
        )
    poses, error = signature(effect, robot)
    left = Residuals.at(dict(zip(("x_mm", "y_mm", "z_mm"), poses.T, strict=True)), 1e3 * error, ("x", "y", "z"), "µm")
    return still(
        Change(left, left, after_title=effect.name),
        caption=f"What {effect.name} of plausible size leaves after the geometry was fitted.",
    )


# -- On the picture of a camera ---------------------------------------------------------------------------------------

_WIDTH = 820
_MOST = 1500


@dataclass(frozen=True, eq=False)
class Reprojection:
    """``seen_px`` (n, 2) and ``error_px`` (n, 2) seen minus predicted, in a picture of ``size_px`` (width, height).

    ``image`` (height, width) in grey, 0 to 255, is drawn below them where there is one; ``line`` (n,) the row's number.
    """

    seen_px: Floats
    error_px: Floats
    size_px: tuple[int, int]
    line: NDArray[np.int64]
    image: NDArray[np.uint8] | None = None


def reprojection(state: Reprojection) -> Picture[Reprojection]:
    """Arrows from where the marker was seen along its error, much longer than they are; the scale is written below."""
    width, height = state.size_px
    sources = sources_of(_tables(state))
    made = figure(
        "u, px", "v, px", frame_width=_WIDTH, frame_height=int(_WIDTH * height / width), x_range=Range1d(0, width),
        y_range=Range1d(height, 0),
    )  # fmt: skip
    if state.image is not None:
        # pictures are stored from the top down, the axis runs down as well; pale, so that arrows stand out
        grey = LinearColorMapper(palette="Greys256", low=0, high=255)
        made.image([state.image], x=0, y=0, dw=width, dh=height, color_mapper=grey, alpha=0.45)
    size = np.hypot(*state.error_px.T)
    top = round_number(float(np.nanquantile(size, 0.99)) if len(size) else 1.0, up=True) or 1.0
    mapper = LinearColorMapper(palette=SEQUENTIAL[20:], low=0.0, high=top)
    made.segment(
        "u", "v", "u1", "v1", source=sources["marks"], line_width=2, color={"field": "size", "transform": mapper}
    )
    dots = made.scatter("u", "v", source=sources["marks"], size=4, color=INK)
    colour_bar(made, mapper, "error, px")
    made.add_tools(
        hover([dots], ("seen at", "@u{0.0}, @v{0.0} px"), ("error", "@eu{0.00}, @ev{0.00} px"), ("row", "@line"))
    )
    rms = float(np.sqrt(np.nanmean(np.sum(state.error_px**2, axis=1)))) if len(size) else 0.0
    note = f"Arrows are {_magnified(state):.0f} times as long as the errors; {number(rms)} px RMS."
    return Picture.of("reprojection", made, sources, _tables, note=note)


def _magnified(state: Reprojection) -> float:
    size = np.hypot(*state.error_px.T)
    typical = float(np.nanquantile(size, 0.9)) if len(size) else 0.0
    return round_number(0.05 * state.size_px[0] / typical) if typical > 0 else 1.0


def _tables(state: Reprojection) -> Tables:
    keep = np.linspace(0, len(state.seen_px) - 1, min(len(state.seen_px), _MOST)).round().astype(int)
    by = _magnified(state)
    seen, error = state.seen_px[keep], state.error_px[keep]
    return {
        "marks": {
            "u": seen[:, 0], "v": seen[:, 1], "u1": seen[:, 0] + by * error[:, 0], "v1": seen[:, 1] + by * error[:, 1],
            "eu": error[:, 0], "ev": error[:, 1], "size": np.hypot(*error.T), "line": state.line[keep],
        }
    }  # fmt: skip
