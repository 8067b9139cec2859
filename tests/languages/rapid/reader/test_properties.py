"""The RAPID reader on generated, damaged and cut texts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.languages.rapid.reader.flow import error_handlers, main_steps
from planner.languages.rapid.reader.reader import read_module, read_task
from planner.languages.rapid.reader.syntax_tree import DataDeclaration, Literal, MoveStatement
from planner.programs.steps import FlowError, TextFault
from tests.languages.rapid.reader.rapid_texts import FULL, codes, faults, program

NUMBERS = st.one_of(
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.4f}"),
    st.integers(-(10**6), 10**6).map(str),
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.6e}"),
)


@settings(max_examples=100, deadline=None)
@given(st.lists(NUMBERS, min_size=3, max_size=3))
def test_numbers_come_back_as_written(texts: list[str]) -> None:
    module, wrong = read_module(f"MODULE a\nCONST pos p:=[{','.join(texts)}];\nENDMODULE")
    assert wrong == () and module is not None
    initial = module.data[0].initial
    assert isinstance(initial, Literal)
    held = np.array([float(text) for text in texts], dtype=np.float32)  # what a controller makes of them
    assert np.array_equal(initial.value, held.astype(float) * 1e-3)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.lists(st.floats(-2000, 2000), min_size=3, max_size=3),
    st.integers(1, 10**6),
    st.floats(0.001, 100),
)
def test_the_quick_way_and_the_ordinary_way_read_the_same(
    q: list[float], p: list[float], ident: int, time: float
) -> None:
    quaternion = ",".join(f"{x + 0.0:.8f}" for x in np.array(q) / np.linalg.norm(q)).replace(
        "-0.00000000", "0"
    )
    place = ",".join(f"{x:.4f}" for x in p).replace("-0.0000,", "0,")
    target = f"[[{place}],[{quaternion}],[0,1,-2,3],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    line = rf"MoveL {target}\ID:={ident},v5\T:={time:.4f},z1,t;"
    text = f"MODULE a\nPROC main()\n{line}\nENDPROC\nENDMODULE"
    found = [read_module(text, fast_moves=quick) for quick in (True, False)]
    assert [f.code for f in found[0][1]] == [f.code for f in found[1][1]]
    if found[0][1]:
        assert "-0" in line
        return
    moves = [module.procedures[0].body[0] for module, _ in found if module is not None]
    one, two = moves
    assert isinstance(one, MoveStatement) and isinstance(two, MoveStatement)
    for name in ("kind", "line", "start", "zone", "tool", "wobj", "speed", "switches"):
        assert getattr(one, name) == getattr(two, name)
    for name in ("id", "time"):
        assert getattr(one, name).value == getattr(two, name).value
    assert isinstance(one.target, Literal) and isinstance(two.target, Literal)
    assert np.array_equal(one.target.value.position, two.target.value.position)
    assert np.array_equal(one.target.value.quaternion, two.target.value.quaternion)
    assert one.target.value.conf == two.target.value.conf


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, len(FULL)),
    st.integers(0, 12),
    st.text(alphabet='[](){}\\;,:="%!.-+*/019eE#\n aMoveIFTHEN_é\x00', max_size=8),
)
def test_damaged_programs_give_faults_or_programs_but_never_fail(at: int, drop: int, put: str) -> None:
    task = read_task({"x.mod": FULL[:at] + put + FULL[at + drop :]})
    assert all(
        isinstance(fault, TextFault) and fault.line >= 1 and fault.column >= 1 for fault in task.faults
    )
    if not task.faults:
        try:
            main_steps(task.modules)
            error_handlers(task.modules)
        except FlowError as wrong:
            assert wrong.faults


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_answered(text: str) -> None:
    task = read_task({"x.mod": text})
    assert task.faults or task.modules


@pytest.mark.parametrize(
    "deep", ["[" * 5000, "(" * 5000, "IF late " * 3000, "IF late THEN\n" * 3000, "-" * 5000, "NOT " * 3000]
)
def test_deep_nesting_is_a_fault(deep: str) -> None:
    assert faults(program(f"answer := {deep}")) or deep.startswith("IF")
    assert faults(program(deep))


def test_every_truncation_is_noticed() -> None:
    body = FULL.rstrip()
    for at in range(0, len(body), 7):
        assert read_task({"x.mod": body[:at]}).faults, at
    # whole statements missing leave the frame damaged too
    assert "rapid.syntax" in codes(body[: body.index("ENDPROC")] + "ENDMODULE")
    assert "rapid.syntax" in codes(body.replace("ENDMODULE", ""))


def test_data_know_their_place() -> None:
    module, _ = read_module(FULL, "left.mod")
    assert module is not None
    holder = module.data[0]
    assert isinstance(holder, DataDeclaration)
    assert (holder.name, holder.storage, holder.kind, holder.line) == ("holder", "TASK PERS", "tooldata", 3)
    assert module.lines == FULL.count("\n") + 1 and module.bytes == len(FULL)
