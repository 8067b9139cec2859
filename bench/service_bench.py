"""The service's store with many jobs: processor time of the lists and searches that the page requests.

On SQLite in its own folder, through the whole service, in its process.
"""

from __future__ import annotations

import random
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from sqlalchemy import insert

JOBS = 10_000
QUERIES = {
    "newest 50": "",
    "200 of them": "limit=200",
    "by title": "sort=title",
    "verified alone": "state=verified",
    "a word that all have": "search=panel",
    "two words": "search=gew%C3%B6lbe%2077",
    "a word that none has": "search=zzzzzz",
    "a tag": "tag=lot%2017",
}
"""Queries by name."""
GOAL_S = 0.1
"""Target processor time [s] of one list."""
RUNS = 9


def run() -> list[dict[str, Any]]:
    """Rows of median processor time [s] of a list of a store with 10,000 jobs, and its spread."""
    from fastapi.testclient import TestClient

    from planner.files import THUMBNAIL
    from planner.service.app import create_app
    from planner.service.job_search import description_columns
    from planner.service.models import FILES
    from planner.service.models import JOBS as TABLE
    from planner.service.security import LOCAL
    from planner.service.service import Options, Service

    given = random.Random(7)
    with tempfile.TemporaryDirectory() as folder:
        service = Service(Options(Path(folder), examiners=1), _Nobody)
        rows = []
        for number in range(JOBS):
            tags = [f"lot {given.randrange(100)}", given.choice(["Ost", "West"])]
            title = f"{given.choice(['Gewölbe', 'Kuppel', 'Wand'])} {number}"
            words = description_columns(f"panel_{number}", title, tags, "cut and glued, see the list " * 4)
            rows.append(
                {
                    "id": f"{number:032x}", "owner": LOCAL, "name": f"panel_{number}", "digest": "0" * 64,
                    "key": f"{number}", "processes": "[]", "created": 1.79e9 + number, "timeout_s": 1.0,
                    "memory_mb": 1.0, "state": given.choice(["verified", "infeasible", "cancelled"]), **words,
                }
            )  # fmt: skip
        with service.database.write() as db:
            db.execute(insert(TABLE), rows)
            named = [(row["id"], name) for row in rows for name in ("report.html", THUMBNAIL)]
            db.execute(insert(FILES), [{"job": j, "name": n, "sha": "0" * 64, "size": 1} for j, n in named])
        client = TestClient(create_app(service), base_url="http://127.0.0.1")
        out = [_row(client, name, query) for name, query in QUERIES.items()]
        service.close()
    return out


class _Nobody:
    """A team that plans nothing."""


def _row(client: Any, name: str, query: str) -> dict[str, Any]:
    times = []
    for _ in range(RUNS):
        start_s = time.process_time()
        answer = client.get(f"/v1/jobs?{query}")
        times.append(time.process_time() - start_s)
        if answer.status_code != 200:
            raise RuntimeError(answer.text)
    count = len(answer.json()["jobs"])
    median = statistics.median(times)
    return {
        "name": f"list of {JOBS} jobs: {name}",
        "median_s": median,
        "spread": max(times) - min(times),
        "ratio": median / GOAL_S,
        "note": f"processor time, {count} jobs; wanted {GOAL_S:g} s",
    }
