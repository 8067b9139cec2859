"""Elements of a page as values, their conversion to HTML, and the style sheet and script of pages.

Sections hold blocks (tables, facts, figures, drawings ...), and blocks hold phrases (text, numbers, marked
words). Other modules build these values. Only :func:`page_html`, :func:`section_html` and :func:`render`
write HTML. There is one style sheet for screen (light and dark) and paper, and one small script.
"""

import base64
import dataclasses
import html
import io
import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from PIL import Image as PillowImage

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM

_PNG: Final = "data:image/png;base64,"
"""Prefix of the data URL of an embedded PNG."""
_MAX_PHONE_COLUMNS: Final = 4
"""Maximum number of table columns that fit on a phone."""
CELL_PICTURE_NAME: Final = "the cell"
"""Name of the picture of a cell."""


@dataclasses.dataclass(frozen=True)
class CodePhrase:
    """A phrase in a fixed-width font: a code, a signal, a digest."""

    text: str


@dataclasses.dataclass(frozen=True)
class Bold:
    """An emphasised phrase."""

    content: "Phrase"


@dataclasses.dataclass(frozen=True)
class MutedPhrase:
    """A de-emphasised phrase."""

    content: "Phrase"


@dataclasses.dataclass(frozen=True)
class TagPhrase:
    """A word with a background. ``kind`` is ``ok``, ``bad``, ``off`` or a severity."""

    kind: str
    word: str


@dataclasses.dataclass(frozen=True)
class FillInBlank:
    """Space to fill in by hand."""


@dataclasses.dataclass(frozen=True)
class JoinedPhrases:
    """Phrases in sequence, without separators."""

    parts: "tuple[Phrase, ...]"


@dataclasses.dataclass(frozen=True)
class StackedPhrases:
    """Phrases on separate lines."""

    parts: "tuple[Phrase, ...]"


Phrase = object
"""A marked phrase, or any other value, which is shown as in :func:`phrase_html`.

Marked phrases are ``CodePhrase``, ``Bold``, ``MutedPhrase``, ``TagPhrase``, ``FillInBlank``,
``JoinedPhrases`` and ``StackedPhrases``.
"""


@dataclasses.dataclass(frozen=True)
class Paragraph:
    """A paragraph. ``kind`` is its CSS class, such as ``soft`` or ``note`` for a de-emphasised one."""

    content: Phrase
    kind: str = ""


@dataclasses.dataclass(frozen=True)
class Heading:
    """A heading within a section."""

    title: Phrase


@dataclasses.dataclass(frozen=True)
class TableBlock:
    """A table. Cells that are numbers are right-aligned."""

    columns: tuple[Phrase, ...]
    rows: tuple[tuple[Phrase, ...], ...]


@dataclasses.dataclass(frozen=True)
class FactsBlock:
    """Names and values in two columns."""

    items: tuple[tuple[Phrase, Phrase], ...]


@dataclasses.dataclass(frozen=True)
class StepsBlock:
    """Numbered instructions."""

    items: tuple[Phrase, ...]


@dataclasses.dataclass(frozen=True)
class TreeBlock:
    """Names with nested subtrees."""

    nodes: "tuple[tuple[Phrase, TreeBlock], ...]"


@dataclasses.dataclass(frozen=True)
class Drawing:
    """Content that is HTML already: a chart as SVG with its legend."""

    html: str


@dataclasses.dataclass(frozen=True)
class Photo:
    """A raster picture, as a data URL. ``labels``: text, and x and y in 0..1 from the upper left corner."""

    address: str
    name: str
    labels: tuple[tuple[str, float, float], ...] = ()


@dataclasses.dataclass(frozen=True)
class FigureBlock:
    """A picture, chart or table with a title above and a note below."""

    title: Phrase
    content: "Block"
    note: Phrase = ""


@dataclasses.dataclass(frozen=True)
class BlockGroup:
    """Blocks in sequence. ``spaced`` adds a margin below each."""

    items: "tuple[Block, ...]"
    spaced: bool = False


@dataclasses.dataclass(frozen=True)
class GridBlock:
    """Blocks side by side if there is space. ``kind`` has the CSS class ``two`` or ``three``: how many."""

    items: "tuple[Block, ...]"
    kind: str = "two"


@dataclasses.dataclass(frozen=True)
class Column:
    """Blocks below one another in one cell of a grid."""

    items: "tuple[Block, ...]"


@dataclasses.dataclass(frozen=True)
class Wide:
    """A block of full width."""

    content: "Block"


@dataclasses.dataclass(frozen=True)
class Folded:
    """A block that is shown after a click on its summary."""

    summary: str
    content: "Block"


Block = (
    Paragraph
    | Heading
    | TableBlock
    | FactsBlock
    | StepsBlock
    | TreeBlock
    | Drawing
    | Photo
    | FigureBlock
    | BlockGroup
    | GridBlock
    | Column
    | Wide
    | Folded
)
"""Content of sections."""


@dataclasses.dataclass(frozen=True)
class PageSection:
    """A section of a page with an entry in the list of contents. Sections without content are left out."""

    anchor: str
    title: str
    content: tuple[Block, ...]


@dataclasses.dataclass(frozen=True)
class Tile:
    """A key figure with its name. ``bad`` marks a violated requirement."""

    name: str
    value: str
    unit: str = ""
    bad: bool = False


@dataclasses.dataclass(frozen=True)
class Page:
    """A whole page.

    Attributes:
        title: Title.
        name: Heading.
        verdicts: Kind (``ok``, ``bad``, ``warn`` or none) and words next to the heading.
        about: Description, or None.
        tiles: Key figures.
        sections: Sections.
    """

    title: str
    name: str
    verdicts: tuple[tuple[str, str], ...]
    about: Paragraph | None
    tiles: tuple[Tile, ...]
    sections: tuple[PageSection, ...]


def phrase_html(value: Phrase) -> str:
    """Convert a phrase to HTML: numbers to four digits, None as a dash, everything else escaped."""
    match value:
        case CodePhrase(words):
            return f"<code>{html.escape(words)}</code>"
        case Bold(content):
            return f"<b>{phrase_html(content)}</b>"
        case MutedPhrase(content):
            return f'<span class="soft">{phrase_html(content)}</span>'
        case TagPhrase(kind, word):
            return f'<span class="tag {html.escape(kind)}">{html.escape(word)}</span>'
        case FillInBlank():
            return '<span class="fill"></span>'
        case JoinedPhrases(parts):
            return "".join(phrase_html(part) for part in parts)
        case StackedPhrases(parts):
            return "<br>".join(phrase_html(part) for part in parts)
        case None:
            return "–"
        case bool() | np.bool_():
            return "yes" if value else "no"
        case float() | np.floating():
            return number(float(value))
        case _:
            return html.escape(str(value))


def number(value: float, digits: int = 4) -> str:
    """Format a number to significant digits, with a true minus sign, and without exponent up to 1e7."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    formatted = f"{value:.{digits}g}"
    if "e" in formatted and 1e-4 < abs(value) < 1e7:
        formatted = f"{value:.0f}"
    return formatted.replace("-", "−")


def allowed_deviation(by_place: FloatArray, max_deviation: float) -> str:
    """Format the allowed deviation of a face [mm].

    Args:
        by_place: Allowed deviations (M,) [m] at the points of the face if they vary over it, else empty.
        max_deviation: Maximum allowed deviation [m].

    Returns:
        Text with the limit, or with the median and maximum if it varies.
    """
    if not len(by_place):
        return f"±{number(max_deviation / MM)}"
    median = float(np.median(by_place)) / MM
    return f"the local step height, median {number(median, 2)}, maximum {number(max_deviation / MM, 2)}"


def fixed_decimals(value: float, decimals: int) -> str:
    """Format a number with some decimals, with a true minus sign and no minus zero."""
    out = f"{value:.{decimals}f}"
    return out.lstrip("-") if float(out) == 0.0 else out.replace("-", "−")


def make_table(columns: Iterable[Phrase], rows: Iterable[Iterable[Phrase]]) -> TableBlock:
    """Build a table from any iterables."""
    return TableBlock(tuple(columns), tuple(tuple(row) for row in rows))


def page_html(shown: Page) -> str:
    """Convert a page to one self-contained HTML file."""
    sections = [section for section in shown.sections if section.content]
    links = "".join(f'<a href="#{part.anchor}">{html.escape(part.title)}</a>' for part in sections)
    verdicts = " ".join(
        f'<span class="verdict {kind}">{html.escape(words)}</span>' for kind, words in shown.verdicts
    )
    about = render(shown.about) if shown.about is not None else ""
    tiles = "".join(_tile(tile) for tile in shown.tiles)
    tiles = f'<div class="tiles">{tiles}</div>' if tiles else ""
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{html.escape(shown.title)}</title><style>{CSS}</style></head><body><main>"
        f"<header><h1>{html.escape(shown.name)}</h1>{verdicts}</header>{about}"
        f"<nav>{links}</nav>{tiles}{''.join(section_html(part) for part in sections)}"
        "<footer>Written by Tandem. This file needs no network.</footer></main>"
        f"<script>{SCRIPT}</script></body></html>\n"
    )


def section_html(shown: PageSection) -> str:
    """Convert a section to HTML."""
    inner = render(BlockGroup(shown.content))
    return f'<section id="{shown.anchor}"><h2>{html.escape(shown.title)}</h2>{inner}</section>'


def render(block: Block) -> str:
    """Convert a block to HTML."""
    match block:
        case Paragraph(content, kind):
            style = f' class="{kind}"' if kind else ""
            return f"<p{style}>{phrase_html(content)}</p>"
        case Heading(title):
            return f"<h3>{phrase_html(title)}</h3>"
        case TableBlock():
            return _table(block)
        case FactsBlock(items):
            rows = (
                f"<div><dt>{phrase_html(name)}</dt><dd>{phrase_html(value)}</dd></div>"
                for name, value in items
            )
            return f'<dl class="facts">{"".join(rows)}</dl>'
        case StepsBlock(items):
            return f"<ol>{''.join(f'<li>{phrase_html(item)}</li>' for item in items)}</ol>"
        case TreeBlock(nodes):
            rows = (f"<li>{phrase_html(name)}{render(below)}</li>" for name, below in nodes)
            return f"<ul>{''.join(rows)}</ul>" if nodes else ""
        case Drawing(drawn):
            return drawn
        case Photo():
            return _photo(block)
        case FigureBlock(title, content, note):
            foot = render(Paragraph(note, "note")) if note else ""
            return f"<figure><figcaption>{phrase_html(title)}</figcaption>{render(content)}{foot}</figure>"
        case _:
            return _render_container(block)


def _render_container(block: BlockGroup | GridBlock | Column | Wide | Folded) -> str:
    """Convert a block that contains other blocks to HTML."""
    match block:
        case BlockGroup(items, spaced):
            items_html = [render(item) for item in items]
            return "".join(
                f'<div style="margin-bottom:20px">{item_html}</div>' if spaced else item_html
                for item_html in items_html
            )
        case GridBlock(items, kind):
            inner = "".join(render(item) for item in items)
            return f'<div class="grid {kind}">{inner}</div>' if inner else ""
        case Column(items):
            return f"<div>{''.join(render(item) for item in items)}</div>"
        case Wide(content):
            return f'<div class="wide">{render(content)}</div>'
        case Folded(summary, content):
            return f"<details><summary>{html.escape(summary)}</summary>{render(content)}</details>"


def _table(shown: TableBlock) -> str:
    """Convert a table to HTML. A column with a number has a right-aligned heading."""
    number_columns = {i for row in shown.rows for i, cell in enumerate(row) if _number_class(cell)}
    body = (
        f"<tr>{''.join(f'<td{_number_class(cell)}>{phrase_html(cell)}</td>' for cell in row)}</tr>"
        for row in shown.rows
    )
    head = "".join(
        f"<th{' class=n' if i in number_columns else ''}>{phrase_html(c)}</th>"
        for i, c in enumerate(shown.columns)
    )
    inner = f"<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody>"
    # a wide table can be focused, so that arrow keys scroll it
    focusable = ' tabindex="0"' if len(shown.columns) > _MAX_PHONE_COLUMNS else ""
    return f'<div class="scroll"{focusable}><table>{inner}</table></div>'


def _number_class(cell: Phrase) -> str:
    """Return the HTML attribute that right-aligns a cell, empty if the cell is not a number."""
    return ' class="n"' if isinstance(cell, int | float | np.number) and not isinstance(cell, bool) else ""


def _photo(shown: Photo) -> str:
    """Convert a photo with its labels to HTML."""
    labels = "".join(
        f'<span style="left:{100 * x:.1f}%;top:{100 * y:.1f}%">{html.escape(name)}</span>'
        for name, x, y in shown.labels
    )
    return f'<div class="picture"><img alt="{html.escape(shown.name)}" src="{shown.address}">{labels}</div>'


def extract_photo(page: str, name: str) -> bytes | None:
    """Extract the PNG of the first photo with a name from a page that :func:`page_html` wrote.

    This serves callers that have only the saved page.

    Args:
        page: HTML of the page.
        name: Name of the photo.

    Returns:
        PNG, or None if there is no such photo.

    Raises:
        ValueError: The photo is not valid base64.
    """
    prefix = f'<img alt="{html.escape(name)}" src="{_PNG}'
    _, separator, rest = page.partition(prefix)
    return base64.b64decode(rest.partition('"')[0], validate=True) if separator else None


def _tile(shown: Tile) -> str:
    """Convert a key figure to HTML."""
    kind = "tile bad" if shown.bad else "tile"
    number_text = html.escape(shown.value.replace("-", "−"))
    value_html = f"<b>{number_text}<small>{html.escape(shown.unit)}</small></b>"
    return f'<div class="{kind}">{value_html}<span>{html.escape(shown.name)}</span></div>'


def png(pixels: FloatArray, alpha: FloatArray | None = None, premultiplied: bool = False) -> str:
    """Encode pixels as a PNG in a data URL.

    Args:
        pixels: Colours (h, w, 3) in 0..1.
        alpha: Opacity (h, w) in 0..1, or None for an opaque picture.
        premultiplied: Whether ``pixels`` are multiplied with the opacity. A PNG has plain colours.
    """
    plain_colours = pixels
    if alpha is not None and premultiplied:
        plain_colours = pixels / np.maximum(alpha, 1e-6)[..., None]
    layers = [plain_colours] if alpha is None else [plain_colours, alpha[..., None]]
    data = (np.clip(np.concatenate(layers, axis=-1), 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    stream = io.BytesIO()
    PillowImage.fromarray(data).save(stream, "PNG", compress_level=6)
    return _PNG + base64.b64encode(stream.getvalue()).decode()


PALETTE: Final = ("#1f6fb4", "#d9662b", "#2a9461", "#8e5bb5", "#b8912a", "#c4497f", "#3aa5a0", "#6b7686")
"""Colours c0 to c7 on white, which curves, features and groups use in turn."""
_PALETTE_VARIABLES: Final = "".join(f"--c{k}:{colour};" for k, colour in enumerate(PALETTE))
CSS: Final = (
    """
:root{--bg:#f6f7f9;--card:#fff;--ink:#1b2330;--soft:#5a6678;--line:#e2e6ec;--grid:#e9edf2;--accent:#0f6e84;
--ok:#187a48;--ok-bg:#e3f4ea;--bad:#c0352b;--bad-bg:#fbe7e5;--warn:#92610a;--warn-bg:#fcf1d9;
--note-bg:#e8eef6;
"""
    + _PALETTE_VARIABLES
    + """
--k-cut:#f2a65a2e;--k-other:#7c8aa014;--k-link:#6fa3d826;color-scheme:light dark}
@media(prefers-color-scheme:dark){:root{--bg:#12161d;--card:#1a2029;--ink:#e7ecf3;--soft:#9aa6b8;
--line:#2c3542;
--grid:#28313d;--accent:#5cc3d8;--ok:#62d196;--ok-bg:#173528;--bad:#ff8a7d;--bad-bg:#432320;--warn:#f0c263;
--warn-bg:#3a2f17;--note-bg:#222d3d;--c0:#62aef0;--c1:#f39a63;--c2:#5fcf98;--c3:#c197e8;--c4:#e2c161;
--c5:#f08bb8;
--c6:#6fdcd6;--c7:#9aa6b8;--k-cut:#f2a65a26;--k-other:#8fa0b812;--k-link:#6fa3d826}}
*{box-sizing:border-box}html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--bg);color:var(--ink);
font:15px/1.5 "Inter","Segoe UI",system-ui,-apple-system,"Helvetica Neue",
Arial,sans-serif;font-feature-settings:"tnum"}
main{max-width:1180px;margin:0 auto;padding:28px 24px 60px}
h1{font-size:27px;line-height:1.2;margin:0;font-weight:650;letter-spacing:-.01em;overflow-wrap:anywhere;min-width:0}
h2{font-size:18px;margin:0 0 14px;font-weight:650;letter-spacing:-.005em}
h3{font-size:14px;margin:20px 0 8px;font-weight:600;color:var(--soft)}
p{margin:0 0 10px}.soft,.note{color:var(--soft)}.note{font-size:13px;margin:6px 0 0}
header{display:flex;flex-wrap:wrap;gap:10px 18px;align-items:center;margin-bottom:6px}
.verdict{font-weight:650;font-size:14px;padding:5px 14px;border-radius:99px;background:var(--note-bg)}
.verdict.ok{color:var(--ok);background:var(--ok-bg)}.verdict.bad{color:var(--bad);background:var(--bad-bg)}
.verdict.warn{color:var(--warn);background:var(--warn-bg)}
nav{display:flex;flex-wrap:wrap;gap:4px 16px;margin:4px 0 18px;font-size:13px}
nav a{color:var(--soft);text-decoration:none}nav a:hover{color:var(--accent)}
section{background:var(--card);border:1px solid var(--line);border-radius:12px;padding:20px 22px;
margin:0 0 18px}
.tiles{display:grid;grid-template-columns:repeat(auto-fill,minmax(160px,1fr));background:var(--card);
border:1px solid var(--line);border-radius:12px;overflow:hidden;margin:0 0 18px}
.tile{padding:13px 16px;box-shadow:1px 1px 0 var(--line)}.tile b{display:block;font-size:21px;
font-weight:650;line-height:1.25;
letter-spacing:-.01em}.tile b small{font-size:13px;font-weight:500;color:var(--soft);margin-left:3px}
.tile span{color:var(--soft);font-size:12.5px}.tile.bad b{color:var(--bad)}
.grid{display:grid;gap:18px 26px}
.grid.two{grid-template-columns:repeat(auto-fit,minmax(min(460px,100%),1fr))}
.grid.three{grid-template-columns:repeat(auto-fit,minmax(min(300px,100%),1fr))}
.grid+figure,.scroll+.scroll,.wide+.grid,.grid+.grid{margin-top:20px}.part+.part{margin-top:26px}
figure{margin:0;min-width:0}figcaption{font-weight:600;font-size:13.5px;margin:0 0 6px}
svg.chart,svg.plot{display:block;width:100%;height:auto;overflow:visible}
svg text{font-size:11px;fill:var(--soft)}.xtick,.xlabel,.ylabel{text-anchor:middle}.ytick{text-anchor:end}
svg .mid{text-anchor:middle}.limit-name{text-anchor:end;fill:var(--bad)}
.grid-line,svg .grid{stroke:var(--grid);stroke-width:1}.axis{stroke:var(--soft);stroke-width:1}
.limit{stroke:var(--bad);stroke-width:1.2;stroke-dasharray:5 4}.line{fill:none;stroke-width:1.7;
stroke-linejoin:round}
.thin{fill:none;stroke-width:1.1;stroke-linejoin:round}.dashed{stroke-dasharray:4 3}
.dot{fill:var(--c,currentColor);stroke:none}
.edge{fill:none;stroke:var(--soft);stroke-width:1}.edge.back{stroke-dasharray:3 3;opacity:.55}
svg .bar{fill:var(--c0);opacity:.75}
.c0{stroke:var(--c0);--c:var(--c0)}.c1{stroke:var(--c1);--c:var(--c1)}.c2{stroke:var(--c2);--c:var(--c2)}
.c3{stroke:var(--c3);--c:var(--c3)}.c4{stroke:var(--c4);--c:var(--c4)}.c5{stroke:var(--c5);--c:var(--c5)}
.c6{stroke:var(--c6);--c:var(--c6)}.c7{stroke:var(--c7);--c:var(--c7)}
.band{fill:var(--k-other)}.band.k-cut,.band.k-form,.band.k-mill{fill:var(--k-cut)}.band.k-link,.band.k-transit{fill:var(--k-link)}
.cursor{stroke:var(--soft);stroke-width:1;visibility:hidden}
.legend{display:flex;flex-wrap:wrap;gap:2px 14px;font-size:12px;color:var(--soft);margin:2px 0 0 52px}
.key::before{content:"";display:inline-block;width:14px;height:3px;border-radius:2px;background:var(--c);
margin-right:6px;vertical-align:middle}
.swatch::before{content:"";display:inline-block;width:12px;height:12px;border-radius:3px;
background:var(--s);
margin-right:6px;vertical-align:-1px;border:1px solid var(--line)}
.scroll{overflow-x:auto}table{border-collapse:collapse;width:100%;font-size:13.5px}
th{text-align:left;font-weight:600;color:var(--soft);font-size:12.5px}th,td{padding:6px 12px 6px 0;
vertical-align:top;
border-bottom:1px solid var(--line)}td.n,th.n{text-align:right}td.n{font-variant-numeric:tabular-nums;
white-space:nowrap}
tr:last-child td{border-bottom:0}
.tag{display:inline-block;font-size:12px;font-weight:600;padding:1px 9px;border-radius:99px;
white-space:nowrap}
.tag.ok{color:var(--ok);background:var(--ok-bg)}.tag.bad,.tag.error{color:var(--bad);
background:var(--bad-bg)}
.tag.warning{color:var(--warn);background:var(--warn-bg)}.tag.note,.tag.off{color:var(--soft);
background:var(--note-bg)}
code{font:12.5px ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;overflow-wrap:anywhere}
td code{font-size:11.5px;overflow-wrap:normal;white-space:nowrap}
.facts{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(330px,100%),1fr));gap:0 28px;margin:0}
.facts div{display:flex;gap:14px;justify-content:space-between;padding:5px 0;
border-bottom:1px solid var(--line)}
dt{color:var(--soft)}dd{margin:0;text-align:right;font-variant-numeric:tabular-nums}
.picture{position:relative;margin:0 auto;max-width:1000px}.picture img{display:block;width:100%}
.picture span{position:absolute;transform:translate(-50%,0);font-size:12.5px;font-weight:600;
color:var(--soft)}
.fill{display:inline-block;min-width:90px;border-bottom:1.5px solid var(--soft);height:1.1em}
.steps{margin:0;padding-left:22px}.steps li{padding:3px 0}.box{display:inline-block;width:13px;height:13px;
border:1.5px solid var(--soft);border-radius:3px;margin-right:9px;vertical-align:-1px}
details summary{cursor:pointer;color:var(--soft);font-size:13.5px}footer{color:var(--soft);font-size:12.5px}
#tip{position:fixed;pointer-events:none;background:var(--ink);color:var(--bg);font-size:12px;
line-height:1.45;padding:6px 9px;
border-radius:7px;display:none;z-index:9;white-space:nowrap}
#tip i{display:inline-block;width:9px;height:9px;border-radius:2px;margin-right:6px}
@media print{:root{--bg:#fff;--card:#fff;--ink:#000;--soft:#444;--line:#ccc;--grid:#e4e4e4;
color-scheme:light}
body{font-size:10.5pt}main{max-width:none;padding:0}section{border:0;padding:0;margin:0 0 14pt;
border-radius:0}
nav{display:none}figure,.tile,tr,.facts div{break-inside:avoid}h2,h3,figcaption{break-after:avoid}
#setup{break-before:page;break-after:page}.grid.two{grid-template-columns:1fr 1fr}
.grid.three{grid-template-columns:1fr 1fr 1fr}
*{-webkit-print-color-adjust:exact;print-color-adjust:exact}@page{margin:14mm}}
"""
)
"""Style sheet of every page."""

SCRIPT: Final = """
(()=>{const tip=document.createElement('div');tip.id='tip';document.body.append(tip);
const num=s=>s.split(' ').map(Number),show=v=>(+v.toPrecision(4)).toString().replace('-','\\u2212');
for(const svg of document.querySelectorAll('svg.chart')){
 const [a,b,x0,x1]=num(svg.dataset.x),[p,q,y0,y1]=num(svg.dataset.y),cursor=svg.querySelector('.cursor');
 const lines=[...svg.querySelectorAll('polyline')].map(l=>({name:l.dataset.name,
  color:getComputedStyle(l).stroke,xy:l.getAttribute('points').split(' ').map(t=>t.split(',').map(Number))}
));
 const off=()=>{tip.style.display='none';cursor.style.visibility='hidden'};
 svg.addEventListener('pointerleave',off);
 svg.addEventListener('pointermove',e=>{const r=svg.getBoundingClientRect(),
  x=(e.clientX-r.left)*svg.viewBox.baseVal.width/r.width;
  if(x<a||x>b)return off();
  cursor.setAttribute('x1',x);cursor.setAttribute('x2',x);cursor.setAttribute('y1',q);
cursor.setAttribute('y2',p);
  cursor.style.visibility='visible';
  let out='<b>'+show(x0+(x-a)/(b-a)*(x1-x0))+'</b> '+svg.dataset.unit;
  for(const l of lines){const k=l.xy.findIndex(t=>t[0]>=x);if(k<1)continue;
   const [u,v]=[l.xy[k-1],l.xy[k]],s=(x-u[0])/Math.max(v[0]-u[0],1e-9),y=u[1]+s*(v[1]-u[1]);
   out+='<br><i style="background:'+l.color+'"></i>'+l.name+' '+show(y0+(p-y)/(p-q)*(y1-y0))}
  tip.innerHTML=out;tip.style.display='block';
  tip.style.left=Math.min(e.clientX+14,innerWidth-tip.offsetWidth-8)+'px';
tip.style.top=(e.clientY+14)+'px'})}})();
"""
"""Script of the report: shows values of charts at the pointer."""
