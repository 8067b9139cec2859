"""Pieces of HTML: escaped text, numbers, tables, figures, pictures; the page's style and script.

One style sheet for screen (light and dark) and paper, one small script.
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from PIL import Image

from planner.geometry.arrays import FloatArray


class Raw(str):
    """Text that is HTML already."""

    __slots__ = ()


def text(value: Any) -> str:
    """A value as escaped HTML: numbers to four digits, None as a dash, :class:`Raw` as it is."""
    if isinstance(value, Raw):
        return str(value)
    if value is None:
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return number(float(value))
    return html.escape(str(value))


def number(value: float, digits: int = 4) -> str:
    """A number to so many significant digits, with a true minus sign."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    size = f"{value:.{digits}g}"
    if "e" in size and 1e-4 < abs(value) < 1e7:
        size = f"{value:.0f}"
    return size.replace("-", "−")


def fixed(value: float, places: int) -> str:
    """A number with so many decimals, with a true minus sign and no minus zero."""
    out = f"{value:.{places}f}"
    return out.lstrip("-") if float(out) == 0.0 else out.replace("-", "−")


def table(columns: Sequence[Any], rows: Iterable[Sequence[Any]], kind: str = "") -> Raw:
    """A table; cells that are numbers are set right."""
    body = []
    right: set[int] = set()
    for row in rows:
        right |= {i for i, cell in enumerate(row) if _number_class(cell)}
        cells = "".join(f"<td{_number_class(cell)}>{text(cell)}</td>" for cell in row)
        body.append(f"<tr>{cells}</tr>")
    head = "".join(f"<th{' class=n' if i in right else ''}>{text(c)}</th>" for i, c in enumerate(columns))
    style = f' class="{kind}"' if kind else ""
    inner = f"<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody>"
    return Raw(f'<div class="scroll"><table{style}>{inner}</table></div>')


def _number_class(cell: Any) -> str:
    return ' class="n"' if isinstance(cell, int | float | np.number) and not isinstance(cell, bool) else ""


def facts(items: Iterable[tuple[Any, Any]]) -> Raw:
    """Names and values in two columns."""
    rows = "".join(f"<div><dt>{text(name)}</dt><dd>{text(value)}</dd></div>" for name, value in items)
    return Raw(f'<dl class="facts">{rows}</dl>')


def figure(title: Any, content: str, note: Any = "") -> Raw:
    """A picture or chart with a title above and a note below."""
    foot = f'<p class="note">{text(note)}</p>' if note else ""
    return Raw(f"<figure><figcaption>{text(title)}</figcaption>{content}{foot}</figure>")


def section(anchor: str, title: str, *content: str) -> Raw:
    """A section of the page; nothing when it has no content."""
    inner = "".join(content)
    return Raw(f'<section id="{anchor}"><h2>{html.escape(title)}</h2>{inner}</section>') if inner else Raw("")


def grid(items: Iterable[str], kind: str = "two") -> Raw:
    """Items side by side where there is room."""
    inner = "".join(items)
    return Raw(f'<div class="grid {kind}">{inner}</div>') if inner else Raw("")


def png(pixels: FloatArray, alpha: FloatArray | None = None, premultiplied: bool = False) -> str:
    """A data address of a PNG of pixels (h, w, 3) and alpha (h, w), both in 0..1."""
    color = pixels
    if alpha is not None and premultiplied:
        color = pixels / np.maximum(alpha, 1e-6)[..., None]
    layers = [color] if alpha is None else [color, alpha[..., None]]
    data = (np.clip(np.concatenate(layers, axis=-1), 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(data).save(stream, "PNG", compress_level=6)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


CSS: Final = """
:root{--bg:#f6f7f9;--card:#fff;--ink:#1b2330;--soft:#5a6678;--line:#e2e6ec;--grid:#e9edf2;--accent:#0f6e84;
--ok:#1a7f4b;--ok-bg:#e3f4ea;--bad:#c0352b;--bad-bg:#fbe7e5;--warn:#96650a;--warn-bg:#fcf1d9;
--note-bg:#e8eef6;
--c0:#1f6fb4;--c1:#d9662b;--c2:#2a9461;--c3:#8e5bb5;--c4:#b8912a;--c5:#c4497f;--c6:#3aa5a0;--c7:#6b7686;
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
h1{font-size:27px;line-height:1.2;margin:0;font-weight:650;letter-spacing:-.01em}
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
.edge{fill:none;stroke:var(--soft);stroke-width:1}.edge.back{stroke-dasharray:3 3;opacity:.55}
.bar{fill:var(--c0);opacity:.75}.dot{stroke:none}
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
