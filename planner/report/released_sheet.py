"""The released sheet in the replay: its shape after springback, next to the shape under the tools.

For an exhibit of kind ``released`` the page contains heights over a grid as integers of 0.01 mm. Its script
builds both surfaces from them, the released one coloured by its deviation, with a switch and a key. They
replace the flat sheet.
"""

import html
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.plans import Plan
from planner.report import charts, markup
from planner.report.time_bar import embed_json

UNITS_PER_MM: Final = 100.0
"""Integer units per millimetre of heights and deviations."""
SHEET_KEY_COLOURS: Final = 33
"""Number of colours of the key, evenly spaced over its scale."""

_SCRIPT: Final = """
addEventListener('replay',({detail:view})=>{
 const D=JSON.parse(document.getElementById('released').textContent),
 box=document.querySelector('#sheet input'),more=document.querySelector('#sheet .more');let made=null;
 const surface=(s,z,paint,opacity)=>{const W=s.x.length,H=s.y.length,p=[],c=[],t=[];
  for(let j=0;j<H;j++)for(let i=0;i<W;i++){p.push(s.x[i],s.y[j],z[j*W+i]/s.per_mm);
   if(i&&j){const b=j*W+i,a=b-1,d=b-W,e=d-1;t.push(e,d,b,e,b,a)}}
  const g=new THREE.BufferGeometry();g.setAttribute('position',new THREE.Float32BufferAttribute(p,3));
  g.setIndex(t);g.computeVertexNormals();const n=g.attributes.normal.array;
  for(let k=0;k<W*H;k++){const lit=.6+.4*Math.abs(.35*n[3*k]+.2*n[3*k+1]+.915*n[3*k+2]);
   c.push(...paint(k).map(v=>v*lit))}
  g.setAttribute('color',new THREE.Float32BufferAttribute(c,3));
  return new THREE.Mesh(g,new THREE.MeshBasicMaterial({vertexColors:true,side:THREE.DoubleSide,
   transparent:opacity<1,opacity,depthWrite:opacity>=1}))};
 const rgb=v=>[1,3,5].map(i=>parseInt(v.slice(i,i+2),16)/255),none=rgb('#9aa4b0');
 const build=()=>D.flatMap(s=>{const n=s.colours.length-1,shade=s.colours.map(rgb),
   paint=k=>s.deviation[k]===null?none:
    shade[Math.round(n*Math.min(Math.max(.5+.5*s.deviation[k]/s.per_mm/s.limit,0),1))];
   return [surface(s,s.released,paint,1),surface(s,s.formed,()=>none,.4)]});
 const show=()=>{if(!made&&box.checked){made=build();for(const one of made)view.attach('block',one)}
  for(const one of made??[])one.visible=box.checked;view.hide('stock',box.checked);more.hidden=!box.checked};
 box.onchange=show;show()});
"""
"""Script of the switch: builds the surfaces when they are first shown."""


def sheet_data(plan: Plan) -> list[dict[str, Any]]:
    """Return the data of each sheet whose springback is known.

    Keys: ``x`` (W,), ``y`` (H,) [mm] in the stock frame; heights ``formed`` and ``released``, and
    ``deviation``, as flat lists (H * W) of integers in units of 1 mm / ``per_mm``, row by row along y, None
    where unknown; ``colours`` from ``-limit`` to ``limit`` [mm]; ``note``.

    Args:
        plan: Plan.
    """
    exhibits = [exhibit for operation in plan.operations for exhibit in operation.targets.exhibits.values()]
    return [
        exhibit_data(exhibit)
        for exhibit in exhibits
        if isinstance(exhibit, Mapping) and exhibit.get("kind") == "released"
    ]


def exhibit_data(exhibit: Mapping[str, Any]) -> dict[str, Any]:
    """Return the data of one exhibit of kind ``released``, with the keys of :func:`sheet_data`."""
    limit = float(exhibit["limit"])
    shades = charts.diverging(np.linspace(-limit, limit, SHEET_KEY_COLOURS), limit)
    return {
        "x": [round(float(v) / MM, 2) for v in exhibit["x"]],
        "y": [round(float(v) / MM, 2) for v in exhibit["y"]],
        "per_mm": UNITS_PER_MM,
        "formed": _integers(np.asarray(exhibit["formed"]) / MM),
        "released": _integers(np.asarray(exhibit["released"]) / MM),
        "deviation": _integers(np.asarray(exhibit["deviation"])),
        "limit": limit,
        "colours": ["#" + "".join(f"{round(255 * float(c)):02x}" for c in shade) for shade in shades],
        "note": str(exhibit.get("note", "")),
    }


def _integers(value: FloatArray) -> list[int | None]:
    """Return values [mm] (...) as a flat list of integer units, None for values that are not finite."""
    return [round(float(v) * UNITS_PER_MM) if np.isfinite(v) else None for v in value.ravel()]


def sheet_switch(plan: Plan) -> str:
    """Return the HTML of switch, key and surfaces for a replay. Empty if no springback is known.

    Several sheets share one key, with the widest scale of them.
    """
    sheets = sheet_data(plan)
    if not sheets:
        return ""
    limit = max(sheet["limit"] for sheet in sheets)
    for sheet in sheets:
        sheet["limit"] = limit
    colour_stops = ",".join(sheets[0]["colours"])
    notes = "".join(f"<p>{html.escape(note)}</p>" for note in dict.fromkeys(s["note"] for s in sheets))
    limit_text = markup.number(limit)
    return (
        "<div id='sheet' class='panel'><label><input type='checkbox' checked>"
        "sheet after release</label><div class='more' hidden>"
        f"<div class='key' style='background:linear-gradient(90deg,{colour_stops})'></div>"
        f"<div class='ends'><span>−{limit_text} mm</span><span>0</span><span>+{limit_text} mm</span></div>"
        "<p>Colour: deviation from the nominal part; blue too deep, red too shallow. Transparent grey: the "
        f"sheet under the tools.</p>{notes}</div></div>"
        f"{embed_json('released', sheets)}<script>{_SCRIPT}</script>"
    )
