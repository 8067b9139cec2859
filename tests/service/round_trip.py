"""``python -I -S tests/service/round_trip.py FOLDER URL TOKEN NAME``: a round trip of a client script.

Runs with any Python from 3.9 on, does everything that a desk does with a service, by the file
``tandem_client.py`` of FOLDER, and prints the answers as JSON.
"""

from __future__ import annotations

import json
import math
import sys
import urllib.request
from pathlib import Path

folder, url, token, name = sys.argv[1:]
sys.path.insert(0, folder)

import tandem_client  # noqa: E402

STATUS = Path("/proc/self/status")
TABLE = "left.x_mm,left.y_mm,left.z_mm,left.qw,left.qx,left.qy,left.qz,feed_mm_s\n" + "".join(
    f"450,{y},500,0.5,-0.5,0.5,0.5,20\n" for y in range(-50, 51, 20)
)
CELL = {
    "arms": [
        {
            "name": "left",
            "robot": "irb140",
            "tool": {"kind": "wire_holder", "mounting": "along", "side": "start"},
            "home_deg": [0, 0, 0, 0, 45, 0],
        }
    ]
}
PROBLEM = {
    "tandem": 1,
    "name": name,
    "cell": CELL,
    "stock": {"size_mm": [100, 100, 100], "place": {"xyz_mm": [450, 0, 0]}},
    "operations": [
        {"name": "poses", "process": "targets", "arms": ["left"], "file": "targets.csv", "frame": "world"}
    ],
}


def wave() -> tuple:
    """A face as vertices [mm] and faces: 13 x 31 points over the block, faces of four corners."""
    points = [
        (x, y, 60 + x * x / 200 - y * y / 1500) for x in range(-60, 61, 10) for y in range(-150, 151, 10)
    ]
    faces = [
        (31 * i + j, 31 * (i + 1) + j, 31 * (i + 1) + j + 1, 31 * i + j + 1)
        for i in range(12)
        for j in range(30)
    ]
    return points, faces


def open_anonymously(address: str) -> str:
    """Return the answer for a browser without a token."""
    with urllib.request.urlopen(address, timeout=60) as answer:
        return answer.read().decode("utf-8")


def main() -> None:
    out = {"python": sys.version_info[:2], "modules": len(sys.modules)}
    if STATUS.exists():
        rows = dict(line.split(":", 1) for line in STATUS.read_text().splitlines())
        out["import_mb"] = int(rows["VmHWM"].split()[0]) / 1000
    client = tandem_client.Client(url, token)
    files = {"targets.csv": TABLE.encode()}
    out["api"] = client.service()["api"]
    out["found"] = [str(issue) for issue in client.check(PROBLEM, files=files)]
    events = set()
    job = client.submit(PROBLEM, files=files)
    done = client.wait(job, lambda stage, fraction: events.add(stage), timeout_s=300)
    out["heard"] = sorted(events)
    out["state"] = done["state"]
    out["programs"] = client.programs(job)
    out["motion"] = client.motion(job)["operations"][0]["arms"]["left"]["tcp"][0]
    out["report"] = open_anonymously(client.report_url(job, seconds=60))[:15]
    out["replay"] = open_anonymously(client.replay_url(job))[:15]
    out["sent"] = client.file(job, "problem/problem.yaml").decode("utf-8")
    # a mesh goes with its unit
    stock = {"size_mm": [180, 400, 110], "support": "pedestal"}
    face = {"file": wave(), "unit": "mm"}
    wire = {"material": "spring_steel", "diameter_mm": 1.5, "length_mm": 520, "temperature_c": 300}
    cut = {
        "name": "faces",
        "process": "elastic_wire",
        "arms": ["left", "right"],
        "wire": wire,
        "kerf_mm": 2.5,
    }
    part = {"front": {"mesh": face}, "back": {"offset_mm": 15}}
    panel = {
        "tandem": 1,
        "name": "panel \u2028 \x85",
        "cell": Path(__file__).parents[2] / "problems" / "cells" / "two_irb140_facing.yaml",
        "stock": stock,
        "part": part,
        "operations": [cut],
    }
    try:
        client.check(panel, reach=False)
    except tandem_client.TandemError as error:  # the name is none
        out["named"] = [(issue.code, issue.field) for issue in error.issues]
    panel["name"] = "panel"
    out["panel"] = [str(issue) for issue in client.check(panel, reach=False)]
    # what is refused comes back with code, message and field
    refusals = out["refusals"] = []
    for wrong in (
        {**PROBLEM, "stock": {"size_mm": [-1, 100, 100]}, "colour": "red"},
        {**PROBLEM, "stock": {"size_mm": [math.nan, 100, 100]}},
        {**panel, "part": {**part, "front": {"mesh": {"file": wave()}}}},
        {**panel, "part": {**part, "front": {"mesh": {"file": ([[0, 0, 0]], [[0, 1, 2]]), "unit": "mm"}}}},
    ):
        try:
            client.check(wrong, files=files)
            refusals.append([])
        except tandem_client.TandemError as error:
            refusals.append([[issue.code, issue.message, issue.field] for issue in error.issues])
    # cancelled
    other = client.submit({**PROBLEM, "name": name + "_2"}, files=files)
    client.cancel(other)
    out["cancelled"] = client.wait(other, timeout_s=60)["state"]
    out["jobs"] = len(list(client.jobs()))
    client.delete(other)
    try:
        tandem_client.Client(url, token[:-2] + "xx").job(job)
    except tandem_client.TandemError as error:
        out["wrong_token"] = [issue.code for issue in error.issues]
    print(json.dumps(out))


main()
