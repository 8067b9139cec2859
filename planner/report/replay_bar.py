"""The bar at the foot of the replay: play, time, segments, stops and speed, driving Meshcat's animation."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.report.track import Track
from planner.segments import Segment

FloatArray = NDArray[np.float64]
_COLOURS: Final = {
    "cut": "#f08a3c",
    "mill": "#f08a3c",
    "form": "#f08a3c",
    "approach": "#58a6c7",
    "retreat": "#58a6c7",
    "link": "#58a6c7",
    "transit": "#7d9fc0",
    "entry": "#aab4c0",
    "exit": "#aab4c0",
    "setup": "#c9a2c4",
}
_OTHER: Final = "#8d99a8"
Clock = tuple[tuple[float, float], ...]
"""Times of the programs and of the replay [s] that belong together, ascending; straight between them."""

_STYLE: Final = """
#status-message{display:none!important}.dg.ac{z-index:3}
#bar{position:fixed;left:16px;right:16px;bottom:14px;z-index:4;background:rgba(255,255,255,.93);border-radius:12px;
padding:10px 16px 12px;font:14px/1.35 "Inter","Segoe UI",system-ui,-apple-system,Arial,sans-serif;
color:#1b2330;
box-shadow:0 4px 18px rgba(20,30,45,.18);display:grid;grid-template-columns:auto 1fr auto;gap:4px 14px;
align-items:center}
#bar button,#bar select{font:inherit;border:0;background:#e8edf2;color:inherit;border-radius:8px;
height:34px;cursor:pointer}
#bar button{width:42px;font-size:15px}#bar select{padding:0 6px}
#bar .line{position:relative;height:34px;touch-action:none;cursor:pointer}
#bar .seg{position:absolute;top:13px;height:8px}#bar .seg:first-child{border-radius:4px 0 0 4px}
#bar .stop{position:absolute;top:8px;width:2px;height:18px;background:#c0352b}
#bar .knob{position:absolute;top:7px;width:20px;height:20px;margin-left:-10px;border-radius:50%;
background:#fff;
border:3px solid #0f6e84;box-shadow:0 1px 4px rgba(0,0,0,.3);box-sizing:border-box}
#bar .say{grid-column:1/4;display:flex;gap:10px 22px;flex-wrap:wrap;color:#4d596a;
font-size:13px;min-height:18px}
#bar .say b{color:#1b2330;font-variant-numeric:tabular-nums}
#bar .say i{display:inline-block;width:10px;height:10px;
border-radius:3px;margin-right:6px}
"""

_SCRIPT: Final = """
(()=>{const D=JSON.parse(document.getElementById('track').textContent),T=D.end,
 bar=document.getElementById('bar'),
 q=s=>bar.querySelector(s),line=q('.line'),knob=q('.knob'),play=q('button'),speed=q('select');
 let t=0,going=false,last=0,drag=false;
 for(const [a,b,name,color] of D.segments){const e=document.createElement('div');e.className='seg';
e.title=name;
  e.style.cssText=`left:${100*a/T}%;width:${100*(b-a)/T}%;background:${color}`;line.prepend(e)}
 for(const [a,text] of D.stops){const e=document.createElement('div');e.className='stop';e.title=text;
  e.style.left=`${100*a/T}%`;line.append(e)}
 line.append(knob);
 const clock=s=>`${Math.floor(s/60)}:${(s%60).toFixed(1).padStart(4,'0')}`;
 const draw=()=>{knob.style.left=`${100*t/T}%`;
  const s=D.segments.find(v=>t>=v[0]&&t<=v[1])||D.segments[D.segments.length-1];
  q('.time').textContent=`${clock(t)} / ${clock(T)}`;q('.segment').textContent=s?s[2]:'';
q('.say i').style.background=s?s[3]:'';
  const near=D.stops.filter(v=>Math.abs(v[0]-t)<Math.max(T*.004,.05));
q('.stopped').textContent=near.map(v=>v[1]).join(' · ')};
 const go=v=>{t=Math.min(Math.max(v,0),T);
if(window.viewer){for(const a of viewer.animator.actions){a.paused=false;a.enabled=true}
  viewer.animator.seek(t)}draw()};
 const set=v=>{going=v;play.textContent=v?'\\u275A\\u275A':'\\u25B6';last=performance.now()};
 play.onclick=()=>{if(!going&&t>=T)go(0);set(!going)};
 const at=e=>{const r=line.getBoundingClientRect();go((e.clientX-r.left)/r.width*T)};
 line.onpointerdown=e=>{drag=true;line.setPointerCapture(e.pointerId);at(e)};
 line.onpointermove=e=>{if(drag)at(e)};line.onpointerup=()=>{drag=false};
 addEventListener('keydown',e=>{if(e.code==='Space'){e.preventDefault();play.onclick()}
  if(e.code==='ArrowRight')go(t+T/200);if(e.code==='ArrowLeft')go(t-T/200)});
 const onReplay=v=>{const c=D.clock,k=c.findIndex(p=>p[0]>=v);if(!c.length)return v;
  if(k<1)return c[k?c.length-1:0][1];const [a,b]=[c[k-1],c[k]];
return a[1]+(b[1]-a[1])*(v-a[0])/Math.max(b[0]-a[0],1e-9)};
 const inWork=(v,name)=>{const n=Math.max(D.segments.findIndex(s=>s[2]===name),0),
  before=D.segments.slice(0,n+1).filter(s=>s[2]==='entry'||s[2]==='setup').pop();
return (before?before[1]:0)+v};
 const asked=()=>{const h=new URLSearchParams(location.hash.slice(1)),
  n=k=>h.has(k)&&isFinite(h.get(k))?+h.get(k):null;
  const [t,at,work]=['t','at','work'].map(n);
return t!==null?t:at!==null?onReplay(at):work!==null?inWork(work,h.get('in')):null},start=asked();
 addEventListener('hashchange',()=>{const v=asked();if(v!==null){set(false);go(v)}});
 const step=now=>{if(going&&!drag){go(t+(now-last)/1000*speed.value);if(t>=T)set(false)}last=now;
requestAnimationFrame(step)};
 const ready=()=>{if(window.viewer&&viewer.animator&&viewer.animator.duration>0){
   if(viewer.gui)viewer.gui.close();viewer.animator.play();viewer.animator.pause();
go(start??0);if(start===null)set(true);
   requestAnimationFrame(step)}else setTimeout(ready,60)};
 draw();ready()})();
"""


def bar(name: str, run: Track, clock: Clock = ()) -> str:
    """HTML of the bar for an animation that starts at time 0.

    ``#t=seconds`` in the address stops there, also when it changes; ``#at=`` is a time on the programs'
    clock, which ``clock`` leads over; ``#work=`` one from the start of the work of the operation that has the
    segment ``in=``.
    """
    time = run.time - run.time[0]
    end = float(max(time[-1], 1e-3))
    data = {
        "end": round(end, 3),
        "segments": [(a, b, str(one), colour) for a, b, one, colour in _segments(time, run.segment)],
        "clock": [(round(a, 3), round(b, 3)) for a, b in clock],
        "stops": [(round(at - float(run.time[0]), 3), text) for at, text in run.stops],
    }
    packed = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    best = min((1, 2, 4, 8, 16, 32), key=lambda v: abs(np.log(end / v / 45.0)))
    options = "".join(
        f'<option value="{v}"{" selected" if v == best else ""}>{v:g} ×</option>'
        for v in (0.5, 1, 2, 4, 8, 16, 32)
    )
    return (
        f"<style>{_STYLE}</style><div id='bar'>"
        "<button title='play or pause (space)'>▶</button><div class='line'>"
        f"<div class='knob'></div></div><select title='speed'>{options}</select>"
        f"<div class='say'><span><b>{html.escape(name)}</b></span><span class='time'></span>"
        "<span><i></i><span class='segment'></span></span>"
        "<span class='stopped' style='color:#c0352b'></span></div></div>"
        f"<script type='application/json' id='track'>{packed}</script><script>{_SCRIPT}</script>"
    )


def clock(run: Track, time: FloatArray, labels: Sequence[str]) -> Clock:
    """How the programs' clock, ``time`` (S,) [s] with the ``labels`` (S,) of what is done (keys of
    segments), leads to the replay's: what has the same label in both begins and ends together, and so does
    the whole.

    The replay shows the ways from and to home at a pace of its own, so the clocks differ by more than a
    shift.
    """
    shown = [(one, a, b) for a, b, one, _ in _segments(run.time - run.time[0], run.segment)]
    out: list[tuple[float, float]] = []
    for label, first, last in _runs(labels):
        found = next((i for i, one in enumerate(shown) if one[0].key == label), None)
        if found is not None:
            _, start, end = shown[found]
            shown = shown[found + 1 :]
            out += [(float(time[max(first - 1, 0)]), start), (float(time[last]), end)]
    if not out:
        return ()
    return ((float(time[0]), 0.0), *out, (float(time[-1]), float(run.time[-1] - run.time[0])))


def _runs(labels: Sequence[str]) -> list[tuple[str, int, int]]:
    """Runs of equal labels: label, first and last index."""
    edges = [i for i in range(1, len(labels)) if labels[i] != labels[i - 1]]
    return [
        (str(labels[a]), a, b - 1)
        for a, b in zip([0, *edges], [*edges, len(labels)], strict=True)
        if len(labels)
    ]


def _segments(time: np.ndarray, segments: tuple[Segment, ...]) -> list[tuple[float, float, Segment, str]]:
    """Runs of one segment: start, end, segment, colour; it belongs to the way to its keyframe."""
    out: list[tuple[float, float, Segment, str]] = []
    for i in range(1, len(segments)):
        a, b = round(float(time[i - 1]), 3), round(float(time[i]), 3)
        if out and out[-1][2] == segments[i]:
            out[-1] = (out[-1][0], b, *out[-1][2:])
        else:
            out.append((a, b, segments[i], _COLOURS.get(segments[i].kind, _OTHER)))
    return out
