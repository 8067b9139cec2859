"""The released sheet in the replay: a ghost of what is left once the tools let go, beside what they form.

Of an exhibit of kind ``released`` the page gets heights over a grid as whole numbers of 0.01 mm; its script
makes both surfaces of them, the released one coloured by its deviation, with a switch and a key. They stand
in place of the flat sheet.
"""

import html
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.plans import Plan
from planner.report import charts, markup
from planner.report.time_bar import embedded

PER_MM: Final = 100.0
"""Heights and deviations are whole numbers of 1 mm over this."""
SHADES: Final = 33
"""Colours of the key, evenly from one end of its scale to the other."""

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
"""Script of the switch: makes the surfaces when they are first asked for."""


def data(plan: Plan) -> list[dict[str, Any]]:
    """What the page gets of each sheet whose springback is known: ``x`` (W,), ``y`` (H,) [mm] in the stock
    frame; row by row along y ``formed``, ``released`` and ``deviation`` in parts of a millimetre (`PER_MM`),
    the last one None where nothing is known; ``colours`` from ``-limit`` to ``limit`` [mm]."""
    shown = [one for operation in plan.operations for one in operation.targets.exhibits.values()]
    return [shape_data(one) for one in shown if isinstance(one, Mapping) and one.get("kind") == "released"]


def shape_data(one: Mapping[str, Any]) -> dict[str, Any]:
    """The same of one exhibit."""
    limit = float(one["limit"])
    shades = charts.diverging(np.linspace(-limit, limit, SHADES), limit)
    return {
        "x": [round(float(v) / MM, 2) for v in one["x"]],
        "y": [round(float(v) / MM, 2) for v in one["y"]],
        "per_mm": PER_MM,
        "formed": _whole(np.asarray(one["formed"]) / MM),
        "released": _whole(np.asarray(one["released"]) / MM),
        "deviation": _whole(np.asarray(one["deviation"])),
        "limit": limit,
        "colours": ["#" + "".join(f"{round(255 * float(c)):02x}" for c in shade) for shade in shades],
        "note": str(one.get("note", "")),
    }


def _whole(value: FloatArray) -> list[int | None]:
    return [round(float(v) * PER_MM) if np.isfinite(v) else None for v in value.ravel()]


def switch(plan: Plan) -> str:
    """HTML of switch, key and surfaces for a replay; nothing where no springback is known.

    With several sheets the key is that of the widest scale, and all have it.
    """
    sheets = data(plan)
    if not sheets:
        return ""
    limit = max(sheet["limit"] for sheet in sheets)
    for sheet in sheets:
        sheet["limit"] = limit
    bar = ",".join(sheets[0]["colours"])
    notes = "".join(f"<p>{html.escape(note)}</p>" for note in dict.fromkeys(s["note"] for s in sheets))
    end = markup.number(limit)
    return (
        "<div id='sheet' class='panel'><label><input type='checkbox' checked>"
        "sheet once the tools have let go</label><div class='more' hidden>"
        f"<div class='key' style='background:linear-gradient(90deg,{bar})'></div>"
        f"<div class='ends'><span>−{end} mm</span><span>0</span><span>+{end} mm</span></div>"
        "<p>Colour: off the wanted part; blue too deep, red too shallow. Grey, seen through: the sheet "
        f"under the tools.</p>{notes}</div></div>"
        f"{embedded('released', sheets)}<script>{_SCRIPT}</script>"
    )
