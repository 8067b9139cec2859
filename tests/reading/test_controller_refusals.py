"""Invalid controller sections of problem files: each is refused on reading, by field and line."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml

from planner import pipeline
from planner.issues import TandemError
from planner.languages.rapid import sentences
from planner.languages.rapid.writer.syntax import (
    BOX_LINE_LENGTH,
    MAX_STRING_LENGTH,
    identifier,
    message_box,
    quoted,
    write_lines,
)
from planner.languages.writing.layout import to_ascii
from tests.reading.test_bad_input import CAPITAL, change

LONG = "doAVeryLongNameOfASignal"  # 24 characters, as long as a name may be
HANDSHAKE = {"sync": "handshake"}
FIELD = "cell.controller"
LOCK = FIELD + ".interlock"
OUT = LOCK + ".outputs"
SIGNAL = "operations.0.signal"
SIGNALS = FIELD + ".handshake.signals."
PLACES_FIELD = LOCK + ".places."
SIGNAL_PLACE = {"device": "D1", "device_map": 3}

WRONG: list[tuple[str, Any, str, str]] = [
    (FIELD, {"robotware": 5}, "problem.field", FIELD + ".robotware"),
    (FIELD, {"robotware": "6"}, "problem.field", FIELD + ".robotware"),
    (FIELD, {"options": ["604-2 MultiMove Independent"]}, "post.option", FIELD + ".options"),
    (FIELD, {"options": ["3102-1 MultiMove Coordinated"]}, "post.option", FIELD + ".options"),
    (FIELD, {"options": []}, "post.option", FIELD + ".options"),
    (
        FIELD,
        {"robotware": 7, "options": ["604-1 MultiMove Coordinated"]},
        "post.option",
        FIELD + ".options",
    ),
    (FIELD, {"tasks": ["controller", "T_ROB2"]}, "problem.field", FIELD + ".tasks"),
    (FIELD, {"robots": ["rob1"]}, "post.tasks", FIELD + ".robots"),
    (FIELD, {"robots": ["rob1", "ROB1"]}, "problem.duplicate_name", FIELD + ".robots"),
    (FIELD, {"interlock": {"cycle_signal": "doWirePower"}}, "problem.field", SIGNAL),
    (FIELD, {"interlock": {"motors_signal": "soCycleOn"}}, "problem.field", LOCK + ".motors_signal"),
    (FIELD, {"interlock": {"outputs": {"doWirePower": {"signal": "doWirePower"}}}}, "problem.field", OUT),
    (FIELD, {"interlock": {"outputs": {"doWirePower": {"signal": "soMotorsOn"}}}}, "problem.field", OUT),
    (
        FIELD,
        {"interlock": {"outputs": {"doWirePower": {"device": "Local_IO", "device_map": 4096}}}},
        "problem.field",
        OUT + ".doWirePower.device_map",
    ),
    (
        FIELD,
        {"interlock": {"outputs": {"doWirePower": {"device": "Local_IO", "device_map": -1}}}},
        "problem.field",
        OUT + ".doWirePower.device_map",
    ),
    (
        FIELD,
        {"interlock": {"outputs": {"doWirePower": {"device": "D1"}, "doSpindle": {"device": "d1"}}}},
        "problem.field",
        OUT + ".doWirePower",
    ),
    (FIELD, {"interlock": {"cycle_signal": LONG + "s"}}, "problem.field", LOCK + ".cycle_signal"),
    (FIELD, {"wire_signal": "doStraße"}, "problem.field", FIELD + ".wire_signal"),
    (FIELD, {"io": {"left": {"doWirePower": 0}}}, "problem.field", FIELD + ".io.left.doWirePower"),
    (FIELD, {"io": {"left": {"doWirePower": 4097}}}, "problem.field", FIELD + ".io.left.doWirePower"),
    (FIELD, {"io": {"left": {"doWirePower": 1, "doWater": 1}}}, "problem.field", FIELD + ".io.left"),
    (
        FIELD,
        {"io": {"left": {"doWirePower": 5}}, "interlock": {"outputs": {"doWirePower": {"signal": "doHot"}}}},
        "problem.field",
        OUT + ".doWirePower",
    ),
    (SIGNAL, "soCycleOn", "problem.field", SIGNAL),
    (SIGNAL, "x" * 29, "problem.field", SIGNAL),
    (SIGNAL, "x" * 33, "problem.field", SIGNAL),
    (FIELD, HANDSHAKE | {"wire_signal": "doX", "handshake": {"signals": {"left": {"output": "doWirePower"}}}},
     "problem.field", SIGNAL),
    (FIELD, HANDSHAKE | {"interlock": {"cycle_signal": "doRunning"}}, "problem.field", SIGNALS + "left"),
    (FIELD, HANDSHAKE | {"interlock": {"motors_signal": "diPartnerRunning_lost"}},
     "problem.field", SIGNALS + "right"),
    (FIELD, HANDSHAKE | {"handshake": {"signals": {"right": {"partner_running": "doWirePowerOut"}}}},
     "problem.field", SIGNALS + "right"),
    (FIELD, {"interlock": {"places": {"left": {"doRunning": SIGNAL_PLACE}}}},
     "problem.field", PLACES_FIELD + "left"),
    (FIELD, HANDSHAKE | {"interlock": {"places": {"middle": {"doRunning": SIGNAL_PLACE}}}},
     "problem.field", PLACES_FIELD + "middle"),
    (FIELD, HANDSHAKE | {"interlock": {"places": {"left": {"doNobody": SIGNAL_PLACE}}}},
     "problem.field", PLACES_FIELD + "left"),
    (FIELD, HANDSHAKE | {"interlock": {"places": {"left": {"doRunning": {"device": "D", "device_map": -1}}}}},
     "problem.field", PLACES_FIELD + "left.doRunning.device_map"),
    (FIELD, HANDSHAKE | {"interlock": {"places": {"left": {"doRunning": {"device_map": 1}}}}},
     "problem.field", PLACES_FIELD + "left.doRunning.device"),
    (FIELD, HANDSHAKE | {"interlock": {"outputs": {"doWirePower": {"device": "d1", "device_map": 3}},
                                       "places": {"left": {"doRunning": SIGNAL_PLACE}}}},
     "problem.field", PLACES_FIELD + "left"),
    (FIELD, HANDSHAKE | {"interlock": {"outputs": {"doWirePower": {"device": "d1", "device_map": 3}},
                                       "places": {"left": {"doPartner": SIGNAL_PLACE}}}},
     "problem.field", PLACES_FIELD + "left"),
    (FIELD, HANDSHAKE | {"interlock": {"places": {"left": {"doPartner": SIGNAL_PLACE,
                                                          "doRunning": SIGNAL_PLACE}}}},
     "problem.field", PLACES_FIELD + "left"),
]  # fmt: skip


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(
    ("field", "value", "code", "named"), WRONG, ids=[str(v)[:60] for _, v, _, _ in WRONG]
)
def test_what_controllers_cannot_do_is_refused_by_field_and_line(
    tmp_path: Path, field: str, value: Any, code: str, named: str
) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(yaml.safe_dump(change(CAPITAL, field, value), allow_unicode=True), "utf-8")
    with pytest.raises(TandemError) as refused:
        pipeline.load(path)
    issues = [issue for issue in refused.value.issues if issue.field == named]
    assert [issue.code for issue in issues][:1] == [code], refused.value.issues
    assert issues[0].line is not None and issues[0].file == str(path)


@pytest.mark.parametrize(
    "value",
    [
        {"options": ["604-1 MultiMove Coordinated", "608-1 World Zones"]},
        {"robotware": 7, "options": ["3102-1 MultiMove Coordinated"]},
        {"interlock": {"outputs": {"doWirePower": {"signal": "doX", "device": "D1", "device_map": 4095}}}},
        {"robots": ["rob1", "rob2"]},
        HANDSHAKE
        | {
            "interlock": {
                "outputs": {"doWirePower": {"device": "D1", "device_map": 4}},
                "places": {"left": {"DORUNNING": SIGNAL_PLACE, "diPartnerRunning": SIGNAL_PLACE}},
            }
        },
        HANDSHAKE
        | {
            "handshake": {
                "signals": {
                    "left": {"running": "wireA", "partner_running": "wireB"},
                    "right": {"running": "wireB", "partner_running": "wireA"},
                }
            }
        },
    ],
)
def test_what_controllers_can_do_is_taken(tmp_path: Path, value: Any) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(yaml.safe_dump(change(CAPITAL, FIELD, value)))
    assert pipeline.load(path).name


def test_a_spindle_and_a_wire_do_not_share_a_signal(tmp_path: Path) -> None:
    from tests.processes.milling.plan import small_mill

    data = copy.deepcopy(small_mill.WALL)
    data["cell"]["controller"] = {"interlock": {"motors_signal": "doSpindle"}}
    path = tmp_path / "p.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as refused:
        pipeline.load(path)
    assert "the power of a spindle" in refused.value.issues[0].message


def test_texts_to_the_operator_fit_the_panel() -> None:
    signal, name = "x" * 28, "y" * 24
    texts = sentences
    lines = [
        texts.POSITION_DEVIATION,
        texts.ROTATION_DEVIATION,
        texts.DIFFERS_FROM_PLAN,
        *texts.MOTION_BLOCKED,
        *texts.RESTART_REFUSED,
    ]
    lines += [texts.BASE_OF.format(arm=name)]
    compared = (texts.OBJECT_FRAME_OF, texts.USER_FRAME_OF, texts.HOLDER_OF)
    lines += [sentence.format(name="w_stock_100") for sentence in compared]
    assert max(map(len, lines)) <= MAX_STRING_LENGTH // 2
    assert max(map(len, texts.restart_question(signal))) <= BOX_LINE_LENGTH
    assert len(texts.restart_question(signal)) <= 11


@pytest.mark.parametrize(
    "text", ["Klemmen schließen: Böcke, Stöße – 90°", "ä" * 400, "漢字", "\t\n", "œuvre"]
)
def test_any_text_is_written_in_ascii_within_the_panel(text: str) -> None:
    lines = [*write_lines(text), *message_box("Tandem", text)]
    assert all(line.isascii() for line in lines)
    shown = [part for line in write_lines(text) for part in [line.removeprefix("TPWrite ").removesuffix(";")]]
    assert all(len(part) - 2 <= MAX_STRING_LENGTH // 2 for part in shown)
    assert quoted(to_ascii(text)).isascii()


def test_umlauts_in_names_are_spelt_or_dropped() -> None:
    assert to_ascii("Straße Größe œuvre Ærø") == "Strasse Grosse oeuvre Aero"
    assert identifier("cut/Größe") == "cut_Grosse"
