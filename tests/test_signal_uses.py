"""One signal has one use: what a problem would switch twice is refused, with its field and line."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from planner import catalogue, pipeline
from planner.handshake import Handshake, PartnerSignals
from planner.issues import TandemError
from planner.signal_uses import shared


def cell(sync: str = "multimove", **signals: PartnerSignals) -> Any:
    arms = (SimpleNamespace(name="left"), SimpleNamespace(name="right"))
    return SimpleNamespace(
        arms=arms, controller=SimpleNamespace(sync=sync, handshake=Handshake(signals=signals))
    )


def operation(process: str, signal: str | None, *arms: str, holder: str | None = None) -> Any:
    made = SimpleNamespace(process=process, arms=arms or ("left",))
    if signal is not None:
        made.signal = signal
    if holder is not None:
        made.die = SimpleNamespace(holder="sinking", signal=holder)
    return made


WIRE, BOW, MILL = "elastic_wire", "straight_wire", "milling"


@pytest.mark.parametrize(
    ("of", "operations", "fields"),
    [
        (cell(), [operation(WIRE, "doHot"), operation(BOW, "doHot")], []),
        (cell(), [operation(WIRE, "doHot"), operation(MILL, "doHOT")], ["operations.1.signal"]),
        (
            cell(),
            [operation(WIRE, "doHot", "left"), operation(MILL, "doHot", "right")],
            ["operations.1.signal"],
        ),
        (cell("handshake"), [operation(BOW, "doHot", "left"), operation(MILL, "doHot", "right")], []),
        (cell("handshake"), [operation(MILL, "doPartner", "left")], []),
        (
            cell("handshake"),
            [operation("targets", None, "left", "right"), operation(MILL, "dopartner", "right")],
            ["operations.1.signal"],
        ),
        (
            cell("handshake", left=PartnerSignals("doA", "doA")),
            [operation("targets", None, "left", "right")],
            ["cell.controller.handshake.signals"],
        ),
        (
            cell(),
            [operation(MILL, "doB"), operation("forming", None, "left", "right", holder="doB")],
            ["operations.1.die.signal"],
        ),
    ],
)
def test_one_signal_has_one_use(of: Any, operations: list[Any], fields: list[str]) -> None:
    found = shared(of, operations)
    assert [issue.field for issue in found] == fields
    assert all(issue.code == "problem.signal" and issue.hint for issue in found)


def test_it_is_told_by_line(tmp_path: Any) -> None:
    """A wall is cut by a bow and milled on top by a spindle on the same output."""
    source = catalogue.data_dir("problems") / "flank_wall" / "problem.yaml"
    text = source.read_text().replace("cell: ../cells/", f"cell: {source.parent.parent}/cells/")
    head, own = text.split("operations:\n")
    extra = "  - {name: more, process: straight_wire, arms: [robot], kerf_mm: 2, signal: doSpindle}\n"
    (tmp_path / "problem.yaml").write_text(f"{head}operations:\n{own.rstrip()}\n{extra}")
    with pytest.raises(TandemError) as caught:
        pipeline.load(tmp_path / "problem.yaml")
    found = [issue for issue in caught.value.issues if issue.code == "problem.signal"]
    assert len(found) == 1, caught.value.issues
    (issue,) = found
    line = len(f"{head}operations:\n{own.rstrip()}\n".splitlines()) + 1
    assert f"line {line}" in str(issue)
    assert "doSpindle would switch the power of a hot wire and is a spindle already" in issue.message
