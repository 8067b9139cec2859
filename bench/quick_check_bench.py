"""The quick check while a problem is edited: processor time of its answer in a warm reader.

Each bundled problem is checked as it is, which nobody did before; then with its block moved, which leaves its
targets unchanged; with another setting of its process; and with another block or sheet, which change them.
A reader of the service does the same in its own process.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any, Final

from planner.catalogue import robots

GOAL_S: Final = 2.0
"""Target processor time [s] of a first answer."""
FACETS: Final = 1_000_000
"""Maximum number of facets of a mesh."""
SETTINGS: Final = {
    "forming": ("stepdown_mm", 1.1),
    "elastic_wire": ("kerf_mm", 1.1),
    "straight_wire": ("shape_tol_mm", 0.9),
    "milling": ("shape_tol_mm", 0.9),
    "trim": ("feed_mm_s", 0.9),
    "targets": ("feed_mm_s", 0.9),
}
"""For each process the setting that is edited, and the factor."""
MOVED_MM: Final = 5.0
"""Distance [mm] that a block is moved, and the increase of the size of another block."""
FIRST: Final = "first"
"""Kind of the first query of a problem, which nobody has checked before."""
KINDS: Final = (FIRST, "moved", "setting", "stock")


def edits(source: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """One edit of each kind {kind: {field: value}} of a problem's values; none of a kind that it lacks."""
    result: dict[str, dict[str, Any]] = {}
    body = "sheet" if "sheet" in source else "stock"
    place = source[body].get("place")
    if isinstance(place, dict) and "xyz_mm" in place:
        result["moved"] = {f"{body}.place.xyz_mm.2": place["xyz_mm"][2] - MOVED_MM}
    else:
        base = source["cell"]["arms"][0].get("base", {}).get("xyz_mm", [0.0, 0.0, 0.0])
        result["moved"] = {"cell.arms.0.base.xyz_mm": [base[0] - MOVED_MM, *base[1:]]}
    operation = source["operations"][0]
    name, factor = SETTINGS[operation["process"]]
    result["setting"] = {f"operations.0.{name}": operation.get(name, 0.5) * factor}
    size = source[body]["size_mm"]
    result["stock"] = {f"{body}.size_mm": [value + MOVED_MM for value in size]}
    return result


def run(chosen: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    """Rows of the processor time [s] of first looks, one a problem and kind of edit, and how many were in
    time; of the ``chosen`` problems, all that are bundled where none are given."""
    from planner import pipeline
    from planner.cell import plant
    from planner.reading import strict_yaml

    pipeline.import_dependencies()
    models = plant.ModelCache[plant.CellModel]()
    rows, times = [], {kind: list[float]() for kind in KINDS}
    for path in sorted(robots.data_dir("problems").glob("*/problem.yaml")):
        name = path.parent.name
        if chosen and name not in chosen:
            continue
        with tempfile.TemporaryDirectory() as folder:
            laid = _write_bundle(path, Path(folder))
            source = strict_yaml.read(laid).data
            for kind, fields in {FIRST: {}, **edits(source)}.items():
                spent, answer = _time_quick_check(models, laid, fields)
                times[kind].append(spent)
                about = answer.looked_at or {"targets": 0, "of": 0}
                codes = ", ".join(sorted({i.code for i in answer.issues if i.severity == "error"}))
                note = f"{about['targets']} of {about['of']} targets{f'; {codes}' if codes else ''}"
                rows.append(
                    {"name": f"{name}: {kind}", "median_s": spent, "ratio": spent / GOAL_S, "note": note}
                )
    for kind, own in times.items():
        done = sum(item <= GOAL_S for item in own)
        note = f"processor time; {done} of {len(own)} within {GOAL_S:g} s"
        median = statistics.median(own)
        rows.append(
            {"name": f"first look, {kind}", "median_s": median, "ratio": median / GOAL_S, "note": note}
        )
    return rows


def _write_bundle(path: Path, folder: Path) -> Path:
    """Write a bundled problem as a reader gets it, with its files beside it."""
    from planner import pipeline
    from planner.reading import problem as problem_file

    for name, content in problem_file.bundle(pipeline.load(path)).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder / "problem.yaml"


def _time_quick_check(models: Any, problem: Path, fields: dict[str, Any]) -> tuple[float, Any]:
    """Processor time [s] and answer of a first look."""
    from planner.pipeline import QUICK_CHECK_TARGETS
    from planner.service.reading_result import ReadingOptions
    from planner.service.upload_reader import examine

    uploads = {f"files/{path.name}": path for path in (problem.parent / "files").glob("*")}
    with tempfile.TemporaryDirectory() as own:
        start_s = time.process_time()
        with models.job():
            result = examine(
                Path(own), problem, uploads, FACETS,
                ReadingOptions(reach=True, targets=QUICK_CHECK_TARGETS, fields=fields),
                cache_folder=problem.parent / "kept",
            )  # fmt: skip
        return time.process_time() - start_s, result
