"""Third-party grammars read the programs: RAPID by ``rapidchecker``, KRL for KR C2 by ``kuka/krl.g4``.

The grammar is from antlr/grammars-v4. Both run in an environment of their own, which ``.ci/run`` creates.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from planner import pipeline
from planner.languages.writing.write import program_files
from tests.languages.writing import krl_job
from tests.processes.forming.proof import forming_job
from tests.processes.hotwire.proof import bead_job, straight_job
from tests.proof import handshake_job, held_job, planner_jobs, small_job

PYTHON, GRAMMAR = (os.environ.get(f"TANDEM_OTHERS_{name}", "") for name in ("PYTHON", "KRL"))
"""The Python that has ``rapidchecker`` and ANTLR's runtime; the folder of the parser that ANTLR made."""
reads_rapid = pytest.mark.skipif(not PYTHON, reason="no rapidchecker: TANDEM_OTHERS_PYTHON is not set")
reads_krl = pytest.mark.skipif(not GRAMMAR, reason="no parser of krl.g4: TANDEM_OTHERS_KRL is not set")

RAPID = """
import json, sys
import pyparsing
from rapidchecker.check import check_format
out = {}
for name, text in json.load(sys.stdin).items():
    try:
        out[name] = [str(error) for error in check_format(text)]
    except pyparsing.ParseBaseException as error:
        out[name] = [str(error)]
print(json.dumps(out))
"""
KRL = """
import json, sys
sys.path.insert(0, sys.argv[1])
from antlr4 import CommonTokenStream, InputStream
from antlr4.error.ErrorListener import ErrorListener
from krlLexer import krlLexer
from krlParser import krlParser
class Told(ErrorListener):
    def __init__(self):
        self.found = []
    def syntaxError(self, recognizer, symbol, line, column, message, error):
        self.found.append(f"{line}:{column} {message}")
out = {}
for name, text in json.load(sys.stdin).items():
    told = Told()
    lexer = krlLexer(InputStream(text))
    parser = krlParser(CommonTokenStream(lexer))
    for part in (lexer, parser):
        part.removeErrorListeners()
        part.addErrorListener(told)
    parser.module()
    out[name] = told.found
print(json.dumps(out))
"""

JOBS: dict[str, Callable[[], Mapping[str, str]]] = {
    "an elastic wire, MultiMove": lambda: small_job.programs(6),
    "a bow": lambda: straight_job.programs(6),
    "a bow on a held block": lambda: held_job.programs(6),
    "two forming tools, MultiMove": lambda: forming_job.programs(12),
    "handshake, four phases": lambda: handshake_job.programs("four_phase", 1, 4),
    "handshake, toggle": lambda: handshake_job.programs("toggle", 2, 4),
    "poses": lambda: bead_job.programs("abb"),
    "milling": lambda: milled(),
}
KRL_JOBS: dict[str, Callable[[], Mapping[str, str]]] = {
    "one arm with a spindle": lambda: program_files(*krl_job.alone(dialect="krc2")),
    "handshake, four phases": lambda: program_files(*krl_job.two(dialect="krc2")),
    "handshake, toggle": lambda: program_files(*krl_job.two(kind="toggle", every=2, dialect="krc2")),
}


def milled() -> Mapping[str, str]:
    """An engraving, planned."""
    with tempfile.TemporaryDirectory() as folder:
        return pipeline.plan(pipeline.load(planner_jobs.engrave(Path(folder)))).programs


def reader_messages(script: str, texts: Mapping[str, str], *arguments: str) -> dict[str, list[str]]:
    """Return the messages of a third-party reader on texts, with the line ends that it accepts."""
    plain = {name: text.replace("\r\n", "\n") for name, text in texts.items()}
    done = subprocess.run(
        [PYTHON, "-c", script, *arguments],
        input=json.dumps(plain),
        capture_output=True,
        text=True,
        check=False,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
    )
    assert done.returncode == 0, done.stderr
    results: dict[str, list[str]] = json.loads(done.stdout)
    return results


def modules(job: str) -> dict[str, str]:
    return {
        name: text for name, text in JOBS[job]().items() if Path(name).suffix in (".mod", ".modx", ".sys")
    }


@pytest.mark.sampled(every=4)
@reads_rapid
@pytest.mark.parametrize("job", JOBS)
def test_rapid_is_read(job: str) -> None:
    texts = modules(job)
    assert len(texts) >= 3
    assert reader_messages(RAPID, texts) == {name: [] for name in texts}


@reads_rapid
def test_what_is_no_rapid_is_told() -> None:
    name, text = next((n, t) for n, t in modules("poses").items() if "Cut" in n)
    broken = {"colon": text.replace("\\T:=", "\\T=", 1), "end": text.replace("ENDPROC", "", 1)}
    assert all(reader_messages(RAPID, broken).values()), name


@reads_krl
@pytest.mark.parametrize("job", KRL_JOBS)
def test_krl_is_read(job: str) -> None:
    texts = {name: text for name, text in KRL_JOBS[job]().items() if not name.startswith("controller/")}
    assert len(texts) >= 2
    assert reader_messages(KRL, texts, GRAMMAR) == {name: [] for name in texts}


@reads_krl
def test_what_is_no_krl_is_told() -> None:
    name, text = next((n, t) for n, t in KRL_JOBS["one arm with a spindle"]().items() if n.endswith("_1.src"))
    broken = {"brace": text.replace("}", "", 1), "end": text.replace("\nEND", "\nENDWHILE", 1)}
    assert all(reader_messages(KRL, broken, GRAMMAR).values()), name
