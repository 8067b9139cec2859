"""Rows of ``test_remedies_of_data``: probed points, batches, results and keys."""

from __future__ import annotations

import base64
import re
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final
from unittest import mock

import numpy as np
import pytest
import yaml

from planner import files, pipeline
from planner.batch.batch_file import read_batch
from planner.cli import preparation as align_commands
from planner.cli import statement
from planner.cli.verification import compare_with_file
from planner.issues import Issue
from planner.proof.prove import Prover
from planner.proof.replay import playback
from planner.reading import problem as problem_file
from tests import small_problem
from tests.proof import small_job
from tests.reading.test_setups import CELL as BOW_AND_GRIPPER
from tests.refusals import POSES, change
from tests.remedies.advice import ReportedFigure, Word, Words
from tests.remedies.remedy_rows import GONE, Row, collect_issues, write

WORLD: Final = np.array(
    [[0, -300, 400], [0, 300, 400], [50, 250, 800], [-50, -280, 750], [30, 10, 500], [-40, 0, 900]]
)
LINE: Final = np.array([[0, -300, 400], [0, 0, 500], [0, 300, 600]])


def probe_rows(world: Any, **more: Any) -> Any:
    """Rows of points [mm] as two robots that stand 850 mm on both sides probe them."""
    first = world + np.array([850.0, 0.0, 0.0])
    second = (world - np.array([850.0, 0.0, 0.0])) * [-1, -1, 1]
    return {"rows": np.concatenate([first, second], axis=1).tolist(), **more}


def align(folder: Path, data: Any) -> list[Issue]:
    """``tandem align`` with those rows."""
    head = ",".join(["name", *(f"{arm}.{axis}_mm" for arm in ("left", "right") for axis in "xyz")])
    rows = [f"p{k + 1}," + ",".join(str(v) for v in row) for k, row in enumerate(data["rows"])]
    (folder / "points.csv").write_text("\n".join([head, *rows]) + "\n")
    cell = {**BOW_AND_GRIPPER, "arms": BOW_AND_GRIPPER["arms"][: data.get("arms", 2)]}
    (folder / "cell.yaml").write_text(yaml.safe_dump(cell))
    given = {"tolerance_mm": data.get("tolerance_mm", 0.5), "leave_out": tuple(data.get("leave_out", ()))}
    output = folder / data.get("output", "new.yaml")
    request = align_commands.Align(folder / "cell.yaml", folder / "points.csv", output, **given)
    return collect_issues(lambda: align_commands.run_align(request))


def batch(folder: Path, data: Any) -> list[Issue]:
    """The variants of a batch file."""
    (folder / "base.yaml").write_text(small_problem.PROBLEM)

    def work() -> list[Issue]:
        read_batch(write(folder, data))
        return []

    return collect_issues(work)


GOOD: Final = probe_rows(WORLD)
BATCH: Final = {"batch": 1, "problem": "base.yaml", "vary": {"settings.seed": [1, 2]}}
OTHERS: Final = [
    Row("align.file", align, change(GOOD, "rows.0.2", "4OO"), "correct it", {"rows": GOOD["rows"]}),
    Row("align.cell", align, {**GOOD, "arms": 1}, "take a cell of two robots", {"arms": 2}),
    Row("align.few_points", align, probe_rows(WORLD[:2]), "probe four or more", {"rows": GOOD["rows"]}),
    Row("align.same_points", align, probe_rows(WORLD[[0, 0, 0]]), "probe points far apart",
        {"rows": GOOD["rows"]}),
    Row("align.collinear", align, probe_rows(LINE), "probe one more point off the line by",
        {"rows": probe_rows(np.vstack([LINE, [200, 0, 500]]))["rows"]}),
    Row("align.mirrored", align, {"rows": [[a, b, c, x, -y, z] for a, b, c, x, y, z in GOOD["rows"]]},
        "an axis with the wrong sign", {"rows": GOOD["rows"]}),
    Row("align.units", align, {"rows": [[a, b, c, x / 10, y / 10, z / 10] for a, b, c, x, y,
        z in GOOD["rows"]]}, "seem to be in 'cm', not mm", {"rows": GOOD["rows"]}),
    Row("align.bad_point", align, change(GOOD, "rows.2.4", GOOD["rows"][2][4] + 3.0), "--leave-out p3",
        {"leave_out": [Word("--leave-out (\\w+)")]}),
    Row("align.large_residual", align, {"rows": (np.array(GOOD["rows"]) + np.random.default_rng(3).normal(0,
        5.0, (6, 6))).tolist()}, "allow more: --tolerance-mm",
        {"tolerance_mm": ReportedFigure("points are up to # mm from the fit")}),
    Row("batch.field", batch, {**BATCH, "sped": 3}, "remove it", {"sped": GONE}),
    Row("batch.csv", batch, {"batch": 1, "problem": "base.yaml", "csv": "t.csv"}, "give one for each",
        {"@t.csv": "settings.seed,settings.clearance_mm\n1,10\n"},
        {"t.csv": "settings.seed,settings.clearance_mm\n1\n"}),
]  # fmt: skip

# ---- results ----------------------------------------


def claim(folder: Path, data: Any) -> list[Issue]:
    """An output folder, where a file ``mine`` and a problem in ``a/problem`` are."""
    (folder / "mine").write_text("mine")
    problem = folder / "a" / "problem" / "problem.yaml"
    problem.parent.mkdir(parents=True, exist_ok=True)
    problem.write_text(small_problem.PROBLEM)

    def work() -> Iterable[Issue]:
        files.prepare_folder(folder / data["output"], files.RESULT_ENTRIES, problem)
        return []

    return collect_issues(work)


def prove(folder: Path, data: Any) -> list[Issue]:
    """The proof of a small job's programs from a folder, as somebody changed them: a ``stray`` file, a file
    that is ``missing`` or of no ``text``, one that is ``renamed``, a list with ``line ends`` or modules of
    its own; ``slower`` moves, of which but ``longest`` seconds are proven."""
    if (programs := folder / "programs").exists():
        for path in sorted(programs.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
    texts = dict(small_job.programs(12)) if data.get("planned", True) else {}
    texts |= {data["stray"]: "MODULE stray\r\nENDMODULE\r\n"} if "stray" in data else {}
    own = "T_ROB1/Tandem_1.pgf"
    if "line_ends" in data:
        texts[own] = texts[own].replace("\r\n", data["line_ends"])
    if "listed" in data:
        texts[own] = texts[own].replace("Main", "Cut1")
    if "renamed" in data:
        texts["T_ROB1/" + data["renamed"]] = texts.pop("T_ROB1/TandemMain_1.mod")
    slow = data.get("slower", 1.0)
    for name, text in texts.items():
        if data.get("missing", "-") not in name:
            path = programs / name
            path.parent.mkdir(parents=True, exist_ok=True)
            text = re.sub(r"\\T:=([0-9.]+)", lambda one: f"\\T:={slow * float(one[1]):.5f}", text)
            path.write_bytes(b"\xff\x00" if data.get("text") == name else text.encode("latin-1"))

    def work() -> Iterable[Issue]:
        with mock.patch.object(
            playback, "MAX_MOTION_TIME_S", data.get("longest", playback.MAX_MOTION_TIME_S)
        ):
            last = "verify.continuity" if "longest" in data else "verify.files"
            prover = Prover(small_job.problem(), small_job.claims())
            return prover.prove(pipeline.read_programs(folder), last=last).issues

    return collect_issues(work)


def compare(folder: Path, data: Any) -> list[Issue]:
    """What ``tandem verify --problem`` tells of a result that was planned from the ``stored`` problem."""
    own = write(folder, data["own"])
    stored = folder / "stored.yaml"
    stored.write_text(yaml.safe_dump(data["stored"]))
    for name, content in problem_file.bundle(pipeline.load(stored)).items():
        path = folder / "out" / "problem" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return list(compare_with_file(pipeline, folder / "out", pipeline.load(own), own))


def use_key(folder: Path, data: Any) -> list[Issue]:
    """A key of a file, to ``sign`` or to check with; ``line``: of a file of allowed signers."""
    raw, kind = bytes(range(32)), statement.KEY_KIND.encode()
    public = base64.b64encode(struct.pack(">I", len(kind)) + kind + struct.pack(">I", 32) + raw).decode()
    (folder / "KEY.pub").write_text(f"{statement.KEY_KIND} {public}\n")
    if data["sign"]:
        private = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.ed25519").Ed25519PrivateKey
        words = pytest.importorskip("cryptography.hazmat.primitives.serialization")
        form = words.Encoding.PEM, words.PrivateFormat.OpenSSH, words.NoEncryption()
        (folder / "KEY").write_bytes(private.from_private_bytes(raw).private_bytes(*form))
    else:
        (folder / "KEY").write_text("-----BEGIN OPENSSH PRIVATE KEY-----\n")
    if "line" in data:
        line = data["line"].replace("PUBLIC", f"{statement.KEY_KIND} {public}")
        (folder / data["key"]).write_text(line + "\n")

    def work() -> Iterable[Issue]:
        (statement.read_private_key if data["sign"] else statement.read_public_keys)(folder / data["key"])
        return []

    return collect_issues(work)


ALLOWED: Final = 'me namespaces="file" PUBLIC'
PLANNED: Final = "T_ROB1/TandemMain_1.mod"
RESULTS: Final = [
    Row("output.folder", claim, {"output": "mine"}, "choose another folder", {"output": "new"}),
    Row("output.folder", claim, {"output": "a"}, "choose another", {"output": "b"}),
    Row("output.folder", align, {**GOOD, "output": "points.csv/new.yaml"}, "choose another path",
        {"output": "new.yaml"}),
    Row("verify.no_programs", prove, {"planned": False}, "plan the problem first", {"planned": True}),
    Row("verify.files", prove, {"text": PLANNED}, "plan again", {"text": GONE}),
    Row("verify.files", prove, {"stray": "T_ROB9/stray.mod"}, "remove it", {"stray": GONE}),
    Row("verify.files", prove, {"missing": "T_ROB2"}, "copy all files", {"missing": GONE}),
    Row("verify.files", prove, {"line_ends": "\n"}, "copy the file unchanged", {"line_ends": GONE}),
    Row("verify.files", prove, {"listed": True}, "list every module once", {"listed": GONE}),
    Row("verify.files", prove, {"renamed": "Main.mod"}, "rename the file",
        {"renamed": Word(r"rename the file (\S+?\.mod)")}),
    Row("verify.duration", prove, {"slower": 20.0, "longest": 120.0}, "go faster", {"slower": 1.0}),
    Row("verify.problem_differs", compare, {"own": POSES, "stored": change(POSES, "settings.seed", 7)},
        "yourself", {"stored": POSES}),
    Row("sign.key", use_key, {"sign": True, "key": "KEY.pub"}, "ssh-keygen -t ed25519 -f KEY",
        {"key": Word(r"sign with (\w+)")}),
    Row("sign.key", use_key, {"sign": False, "key": "KEY"}, "check with KEY.pub",
        {"key": Word(r"check with ([\w.]+)")}),
    Row("sign.key", use_key, {"sign": False, "key": "allowed", "line": ALLOWED}, "if it may sign here",
        {"line": Words(r"add (\S+) to these", ALLOWED.replace("file", "file,#"))}),
]  # fmt: skip

ROWS: Final = [*OTHERS, *RESULTS]
