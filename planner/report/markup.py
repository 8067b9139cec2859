"""What a page is made of, as values, and the one way from them to HTML; the page's style and script.

Sections hold blocks (tables, facts, figures, drawings ...), and blocks hold phrases (text, numbers, marked
words). Whoever builds a page builds these values; :func:`page`, :func:`section` and :func:`render` alone
write HTML of them. One style sheet for screen (light and dark) and paper, one small script.
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
"""How the address of a PNG begins that lies in the page itself."""
_NARROW: Final = 4
"""So many columns of a table have room on a telephone."""
CELL: Final = "the cell"
"""What the picture of a cell is called."""


@dataclasses.dataclass(frozen=True)
class Code:
    """A phrase in a fixed-width font: a code, a signal, a digest."""

    text: str


@dataclasses.dataclass(frozen=True)
class Bold:
    """A phrase that stands out."""

    content: "Phrase"


@dataclasses.dataclass(frozen=True)
class Soft:
    """A phrase that stands back."""

    content: "Phrase"


@dataclasses.dataclass(frozen=True)
class Tag:
    """A word on a ground of its own; ``kind``: ``ok``, ``bad``, ``off`` or a severity."""

    kind: str
    word: str


@dataclasses.dataclass(frozen=True)
class Blank:
    """Room to write something in by hand."""


@dataclasses.dataclass(frozen=True)
class Joined:
    """Phrases one after the other, with nothing between them."""

    parts: "tuple[Phrase, ...]"


@dataclasses.dataclass(frozen=True)
class Lines:
    """Phrases below one another."""

    parts: "tuple[Phrase, ...]"


Phrase = object
"""A marked phrase (``Code``, ``Bold``, ``Soft``, ``Tag``, ``Blank``, ``Joined``, ``Lines``), or any other
value, which is shown as :func:`text` says."""


@dataclasses.dataclass(frozen=True)
class Paragraph:
    """A paragraph; ``kind``: ``soft`` or ``note`` for one that stands back."""

    content: Phrase
    kind: str = ""


@dataclasses.dataclass(frozen=True)
class Heading:
    """A heading within a section."""

    title: Phrase


@dataclasses.dataclass(frozen=True)
class Table:
    """A table; cells that are numbers are set right."""

    columns: tuple[Phrase, ...]
    rows: tuple[tuple[Phrase, ...], ...]


@dataclasses.dataclass(frozen=True)
class Facts:
    """Names and values in two columns."""

    items: tuple[tuple[Phrase, Phrase], ...]


@dataclasses.dataclass(frozen=True)
class Steps:
    """What is to be done, numbered."""

    items: tuple[Phrase, ...]


@dataclasses.dataclass(frozen=True)
class Tree:
    """Names with what belongs below each."""

    nodes: "tuple[tuple[Phrase, Tree], ...]"


@dataclasses.dataclass(frozen=True)
class Drawing:
    """What is HTML already, since it is drawn rather than told: a chart as SVG with its legend."""

    html: str


@dataclasses.dataclass(frozen=True)
class Photo:
    """A picture of pixels at a data address; ``labels``: text, x and y in 0..1 from the upper left."""

    address: str
    name: str
    labels: tuple[tuple[str, float, float], ...] = ()


@dataclasses.dataclass(frozen=True)
class Figure:
    """A picture, chart or table with a title above and a note below."""

    title: Phrase
    content: "Block"
    note: Phrase = ""


@dataclasses.dataclass(frozen=True)
class Group:
    """Blocks one after the other; ``apart``: with air below each."""

    items: "tuple[Block, ...]"
    apart: bool = False


@dataclasses.dataclass(frozen=True)
class Grid:
    """Blocks side by side where there is room; ``kind`` says how many: ``two`` or ``three``."""

    items: "tuple[Block, ...]"
    kind: str = "two"


@dataclasses.dataclass(frozen=True)
class Column:
    """Blocks below one another that fill one place of a grid."""

    items: "tuple[Block, ...]"


@dataclasses.dataclass(frozen=True)
class Wide:
    """A block that takes the whole width."""

    content: "Block"


@dataclasses.dataclass(frozen=True)
class Folded:
    """A block that is seen after a click on its summary."""

    summary: str
    content: "Block"


Block = (
    Paragraph
    | Heading
    | Table
    | Facts
    | Steps
    | Tree
    | Drawing
    | Photo
    | Figure
    | Group
    | Grid
    | Column
    | Wide
    | Folded
)
"""What sections hold."""


@dataclasses.dataclass(frozen=True)
class Section:
    """A section of a page, which its list of contents leads to; one without content is left out."""

    anchor: str
    title: str
    content: tuple[Block, ...]


@dataclasses.dataclass(frozen=True)
class Tile:
    """A figure that matters, with its name; ``bad``: it is not as it should be."""

    name: str
    value: str
    unit: str = ""
    bad: bool = False


@dataclasses.dataclass(frozen=True)
class Page:
    """A whole page. ``verdicts``: kind (``ok``, ``bad``, ``warn`` or none) and words beside the name;
    ``about``: what it is of."""

    title: str
    name: str
    verdicts: tuple[tuple[str, str], ...]
    about: Paragraph | None
    tiles: tuple[Tile, ...]
    sections: tuple[Section, ...]


def text(value: Phrase) -> str:
    """A phrase as HTML: marked ones as they say, numbers to four digits, None as a dash, the rest escaped."""
    match value:
        case Code(words):
            return f"<code>{html.escape(words)}</code>"
        case Bold(content):
            return f"<b>{text(content)}</b>"
        case Soft(content):
            return f'<span class="soft">{text(content)}</span>'
        case Tag(kind, word):
            return f'<span class="tag {html.escape(kind)}">{html.escape(word)}</span>'
        case Blank():
            return '<span class="fill"></span>'
        case Joined(parts):
            return "".join(text(part) for part in parts)
        case Lines(parts):
            return "<br>".join(text(part) for part in parts)
        case None:
            return "–"
        case bool() | np.bool_():
            return "yes" if value else "no"
        case float() | np.floating():
            return number(float(value))
        case _:
            return html.escape(str(value))


def number(value: float, digits: int = 4) -> str:
    """A number to so many significant digits, with a true minus sign."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    size = f"{value:.{digits}g}"
    if "e" in size and 1e-4 < abs(value) < 1e7:
        size = f"{value:.0f}"
    return size.replace("-", "−")


def allowed(by_place: FloatArray, most: float) -> str:
    """What a face may be off [mm], as text, of values [m]; the middle and the greatest where it differs by
    place."""
    if not len(by_place):
        return f"±{number(most / MM)}"
    middle = float(np.median(by_place)) / MM
    return f"what steps leave there, {number(middle, 2)} or so and {number(most / MM, 2)} at most,"


def fixed(value: float, places: int) -> str:
    """A number with so many decimals, with a true minus sign and no minus zero."""
    out = f"{value:.{places}f}"
    return out.lstrip("-") if float(out) == 0.0 else out.replace("-", "−")


def table(columns: Iterable[Phrase], rows: Iterable[Iterable[Phrase]]) -> Table:
    """A table of any columns and rows."""
    return Table(tuple(columns), tuple(tuple(row) for row in rows))


def page(shown: Page) -> str:
    """A page as one HTML file that needs nothing else."""
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
        f"<nav>{links}</nav>{tiles}{''.join(section(part) for part in sections)}"
        "<footer>Written by Tandem. This file needs no network.</footer></main>"
        f"<script>{SCRIPT}</script></body></html>\n"
    )


def section(shown: Section) -> str:
    """A section as HTML."""
    inner = render(Group(shown.content))
    return f'<section id="{shown.anchor}"><h2>{html.escape(shown.title)}</h2>{inner}</section>'


def render(block: Block) -> str:
    """A block as HTML."""
    match block:
        case Paragraph(content, kind):
            style = f' class="{kind}"' if kind else ""
            return f"<p{style}>{text(content)}</p>"
        case Heading(title):
            return f"<h3>{text(title)}</h3>"
        case Table():
            return _table(block)
        case Facts(items):
            rows = (f"<div><dt>{text(name)}</dt><dd>{text(value)}</dd></div>" for name, value in items)
            return f'<dl class="facts">{"".join(rows)}</dl>'
        case Steps(items):
            return f"<ol>{''.join(f'<li>{text(item)}</li>' for item in items)}</ol>"
        case Tree(nodes):
            rows = (f"<li>{text(name)}{render(below)}</li>" for name, below in nodes)
            return f"<ul>{''.join(rows)}</ul>" if nodes else ""
        case Drawing(drawn):
            return drawn
        case Photo():
            return _photo(block)
        case Figure(title, content, note):
            foot = render(Paragraph(note, "note")) if note else ""
            return f"<figure><figcaption>{text(title)}</figcaption>{render(content)}{foot}</figure>"
        case _:
            return _arranged(block)


def _arranged(block: Group | Grid | Column | Wide | Folded) -> str:
    match block:
        case Group(items, apart):
            shown = [render(item) for item in items]
            return "".join(f'<div style="margin-bottom:20px">{one}</div>' if apart else one for one in shown)
        case Grid(items, kind):
            inner = "".join(render(item) for item in items)
            return f'<div class="grid {kind}">{inner}</div>' if inner else ""
        case Column(items):
            return f"<div>{''.join(render(item) for item in items)}</div>"
        case Wide(content):
            return f'<div class="wide">{render(content)}</div>'
        case Folded(summary, content):
            return f"<details><summary>{html.escape(summary)}</summary>{render(content)}</details>"


def _table(shown: Table) -> str:
    right = {i for row in shown.rows for i, cell in enumerate(row) if _number_class(cell)}
    body = (
        f"<tr>{''.join(f'<td{_number_class(cell)}>{text(cell)}</td>' for cell in row)}</tr>"
        for row in shown.rows
    )
    head = "".join(
        f"<th{' class=n' if i in right else ''}>{text(c)}</th>" for i, c in enumerate(shown.columns)
    )
    inner = f"<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody>"
    keys = ' tabindex="0"' if len(shown.columns) > _NARROW else ""  # scrolled by arrow keys, too
    return f'<div class="scroll"{keys}><table>{inner}</table></div>'


def _number_class(cell: Phrase) -> str:
    return ' class="n"' if isinstance(cell, int | float | np.number) and not isinstance(cell, bool) else ""


def _photo(shown: Photo) -> str:
    labels = "".join(
        f'<span style="left:{100 * x:.1f}%;top:{100 * y:.1f}%">{html.escape(name)}</span>'
        for name, x, y in shown.labels
    )
    return f'<div class="picture"><img alt="{html.escape(shown.name)}" src="{shown.address}">{labels}</div>'


def photo(page: str, name: str) -> bytes | None:
    """The PNG of the first photo of that ``name`` in a page that :func:`page` wrote; None where none is.

    For whoever has a saved page and not what it was made of. Raises ``ValueError`` for what is no such
    address.
    """
    begin = f'<img alt="{html.escape(name)}" src="{_PNG}'
    _, found, rest = page.partition(begin)
    return base64.b64decode(rest.partition('"')[0], validate=True) if found else None


def _tile(shown: Tile) -> str:
    kind = "tile bad" if shown.bad else "tile"
    value = html.escape(shown.value.replace("-", "−"))
    figure = f"<b>{value}<small>{html.escape(shown.unit)}</small></b>"
    return f'<div class="{kind}">{figure}<span>{html.escape(shown.name)}</span></div>'


def png(pixels: FloatArray, alpha: FloatArray | None = None, premultiplied: bool = False) -> str:
    """A data address of a PNG of pixels (h, w, 3) and alpha (h, w), both in 0..1."""
    color = pixels
    if alpha is not None and premultiplied:
        color = pixels / np.maximum(alpha, 1e-6)[..., None]
    layers = [color] if alpha is None else [color, alpha[..., None]]
    data = (np.clip(np.concatenate(layers, axis=-1), 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    stream = io.BytesIO()
    PillowImage.fromarray(data).save(stream, "PNG", compress_level=6)
    return _PNG + base64.b64encode(stream.getvalue()).decode()


PALETTE: Final = ("#1f6fb4", "#d9662b", "#2a9461", "#8e5bb5", "#b8912a", "#c4497f", "#3aa5a0", "#6b7686")
"""Colours c0 to c7 on white, which curves, features and groups take in turn."""
_ON_WHITE: Final = "".join(f"--c{k}:{colour};" for k, colour in enumerate(PALETTE))
CSS: Final = (
    """
:root{--bg:#f6f7f9;--card:#fff;--ink:#1b2330;--soft:#5a6678;--line:#e2e6ec;--grid:#e9edf2;--accent:#0f6e84;
--ok:#187a48;--ok-bg:#e3f4ea;--bad:#c0352b;--bad-bg:#fbe7e5;--warn:#92610a;--warn-bg:#fcf1d9;
--note-bg:#e8eef6;
"""
    + _ON_WHITE
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
"""The style sheet of every page."""

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
"""The script of the report: figures of charts below the pointer."""
