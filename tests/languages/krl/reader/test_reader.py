"""The KRL reader on programs written by hand after docs/krl.md: results and refusals."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.languages.krl.reader import reader
from planner.languages.krl.reader.values import held_load, parse_value, quaternion
from planner.programs.signals import NumberedSignals
from planner.programs.steps import (
    CarryStep,
    FlowError,
    JointTarget,
    LoadData,
    MessageStep,
    MoveStep,
    RobTarget,
    SignalStep,
    StatusTarget,
    WaitStep,
    rotation,
)
from tests.languages.krl.reader.wall_program import (
    DAT,
    FOOT,
    HEAD,
    INTERRUPT,
    MAIN,
    MOVES,
    NOT_EXTERNAL,
    OLD_FOOT,
    OLDER,
    OPTIONS,
    ROBROOT_CHECK,
    WAIT,
    dialog,
    kinds,
    message,
    read,
    steps,
    texts,
)


def test_the_way_through_the_files():
    found = steps()
    assert [step.kind for step in found] == [
        *(
            "BAS(#INITMOV,0)",
            "$ADVANCE",
            "$IPO_MODE",
            "$ORI_TYPE",
            "$OUT",
            "$ROBROOT",
            "Set_KrlDlg",
            "PTP",
            "PTP",
            "#NOTIFY",
            "$OUT",
        ),
        *("WAIT SEC", "SLIN", "SLIN", "WAIT SEC", "SLIN", "$OUT", "PTP"),
    ]
    signals = [(step.signal, step.value) for step in found if isinstance(step, SignalStep)]
    assert signals == [("doSpindle", 0.0), ("doSpindle", 1.0), ("doSpindle", 0.0)]
    question, told = (step for step in found if isinstance(step, MessageStep))
    assert question.confirm and question.certain
    assert question.text == "Is the stock in place and the way of the arm clear?"
    assert not told.confirm and told.panel == "line"
    pause = next(step for step in found if isinstance(step, WaitStep))
    assert pause.pause == 2.5 and not pause.signal
    assert read().digest == "ab12"


def test_moves_carry_their_segment_target_frames_and_corner():
    home, start, first, turn, stand, last, _ = (s for s in steps() if isinstance(s, MoveStep))
    assert isinstance(home.target, JointTarget) and isinstance(start.target, StatusTarget)
    assert (start.target.status, start.target.turn) == (2, 35)
    assert np.allclose(np.degrees(home.target.joints), [0, -90, 90, 0, 30, 0])
    assert home.speed.axes == (0.12,) * 6 and home.zone.fine
    assert [m.procedure for m in (home, first, turn, stand, last)] == [
        *("main", "approach"),
        *["cut/front"] * 3,
    ]
    assert first.module == "wall_1.src" and first.line == 10
    assert isinstance(first.target, RobTarget) and first.target.conf is None
    assert np.allclose(first.target.position, [-0.002, 0.04, 0.21])
    assert np.allclose(first.tool.pose[:3, :3], Rotation.from_euler("y", 90, degrees=True).as_matrix())
    assert np.allclose(first.wobj.user[:3, 3], [0, 0, 0.5]) and first.wobj_name == "b_stock"
    assert not first.zone.fine and math.isclose(first.zone.tcp, 3e-4) and turn.zone.fine
    assert stand.target.position.tolist() == turn.target.position.tolist() and stand.zone.fine


def test_times_follow_from_ways_turns_and_speeds():
    """10 mm at 20 mm/s; 30 deg about z of the base at sqrt(2) 10 deg/s, by hand; 10 mm at 10 mm/s."""
    moves = [s for s in steps() if isinstance(s, MoveStep) and s.time is not None]
    assert [m.time for m in moves] == pytest.approx([0.5, 30.0 / (math.sqrt(2.0) * 10.0), 0.25, 1.0])


@pytest.mark.parametrize("seed", range(20))
def test_angles_are_those_of_scipy(seed):
    """A, B, C are the intrinsic z, y, x angles of scipy's Rotation."""
    angles = np.random.default_rng(seed).uniform([-180, -90, -180], [180, 90, 180])
    expected = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    assert np.abs(rotation(np.array(quaternion(*angles))) - expected).max() < 1e-12


STATE = message("Waiting for arm right.") + "tm_state=Set_KrlMsg(#STATE,tm_msg,tm_par[],tm_opt)\n"
CLEARED = "tm_gone=Clear_KrlMsg(tm_state)\n"
WAITS = MAIN.replace("wall_1()\n", STATE + WAIT + CLEARED + "wall_1()\n")


def test_a_guarded_wait_is_one_step():
    found = steps(main=WAITS)
    wait = [s for s in found if isinstance(s, WaitStep)][-1]
    assert (wait.signal, wait.value, wait.seconds, wait.flag) == ("diPartner", 1.0, 30.0, "")
    shown = found[found.index(wait) - 1]
    assert (shown.kind, shown.text, shown.panel) == ("#STATE", "Waiting for arm right.", "")


@pytest.mark.parametrize("row", range(1, 11))
def test_a_guarded_wait_needs_each_of_its_statements(row):
    """Without its first one, the loop is no statement that is known; comments do not count."""
    rows = WAIT.splitlines()
    if rows[row].startswith(";"):
        row = 0
    del rows[row]
    assert "syntax" in kinds(main=MAIN.replace("wall_1()\n", "\n".join(rows) + "\nwall_1()\n"))


STOP = """GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
"""

FAULTS = {
    "unknown statement": ("main", "WAIT SEC 2.5", "PULSE($OUT[17],TRUE,2.5)", "syntax"),
    "a wait for an expression": ("main", "WAIT SEC 2.5", "WAIT FOR $IN[5]", "syntax"),
    "a branch": ("main", "WAIT SEC 2.5", "IF $IN[5] THEN", "syntax"),
    "no END": ("moves", "END\n", "", "syntax"),
    "a word behind END": ("moves", "END\n", "END\nHALT\n", "syntax"),
    "a move of the other dialect": ("moves", "SLIN {X -2.0000,Y 40", "LIN {X -2.0000,Y 40", "syntax"),
    "CIRC": ("moves", "WAIT SEC 0.25", "CIRC {X 1.0000},{X 2.0000}", "syntax"),
    "other corner": ("moves", "} C_SPL", "} C_PTP", "syntax"),
    "two corners": ("moves", "} C_SPL", "} C_SPL C_DIS", "syntax"),
    "a strange setting": ("main", "$ADVANCE=3", "$OV_PRO=50", "syntax"),
    "no advance run": ("main", "$ADVANCE=3", "$ADVANCE=0", "type"),
    "a lost variable": ("main", "DECL BOOL tm_gone\n", "", "undeclared"),
    "a variable of another type": ("main", "DECL BOOL tm_gone", "DECL INT tm_gone", "undeclared"),
    "a variable twice": ("main", "DECL BOOL tm_gone", "DECL BOOL tm_gone,tm_gone", "undeclared"),
    "a variable among moves": ("moves", "$VEL.CP", "DECL INT n\n$VEL.CP", "undeclared"),
    "another interrupt": ("main", "INTERRUPT ON 3", "INTERRUPT ON 4", "syntax"),
    "an interrupt that does nothing": ("main", "DO IR_STOPM ( )", "DO wall_1()", "syntax"),
    "a second interrupt": (
        "main",
        "INTERRUPT ON 3",
        "INTERRUPT DECL 21 WHEN $IN[1] DO wall_1()\nINTERRUPT ON 3",
        "syntax",
    ),
    "EXT BAS where it is not needed": (
        "main",
        "DECL BOOL",
        "EXT BAS (BAS_COMMAND :IN,REAL :IN )\nDECL BOOL",
        "syntax",
    ),
    "a dialog that goes on by any key": ("main", "WHILE tm_answer<>1", "WHILE tm_answer==0", "syntax"),
    "a dialog whose second key is yes": ("main", "WHILE tm_answer<>1", "WHILE tm_answer<>2", "syntax"),
    "keys that are swapped": ("main", 'SK_txt[] "Yes"', 'SK_txt[] "No"', "syntax"),
    "a question by one key": ("main", '{SK_type #VALUE,SK_txt[] "No"}', "{SK_type #EMPTY}", "syntax"),
    "another key": ("main", 'SK_txt[] "Yes"', 'SK_txt[] "OK"', "syntax"),
    "a dialog once": ("main", "ENDWHILE\nWAIT SEC 0.1\nENDWHILE", "ENDWHILE\nENDWHILE", "syntax"),
    "a dialog that is not waited for": ("main", "WHILE Exists_KrlDlg", "IF Exists_KrlDlg", "syntax"),
    "a dialog with a time-out": (
        "main",
        "WAIT SEC 0.1\nENDWHILE\nWAIT",
        "WAIT SEC 0.1\nIF $TIMER[2]>5000 THEN\ntm_answer=1\nENDIF\nENDWHILE\nWAIT",
        "syntax",
    ),
    "an answer given": ("main", "tm_answer=0", "tm_answer=1", "syntax"),
    "a text too long": ("main", "Is the stock in place", "Is it" + " or" * 30, "string_length"),
    "a text with a place for a number": ("main", "Is the stock", "Is %1 the stock", "syntax"),
    "another originator": ("main", 'Modul[] "Tandem"', 'Modul[] "KSS"', "syntax"),
    "a message to be quit": ("main", "Set_KrlMsg(#NOTIFY", "Set_KrlMsg(#QUIT", "syntax"),
    "the foot looked at once": ("main", "WHILE (tm_shift", "IF (tm_shift", "syntax"),
    "either of the foot's figures": ("main", ") OR (tm_turn", ") AND (tm_turn", "syntax"),
    "another frame than the foot's": ("main", "SQRT($ROBROOT.X*$ROBROOT.X", "SQRT($BASE.X*$BASE.X", "syntax"),
    "an angle left out": ("main", "+ABS($ROBROOT.C)", "", "syntax"),
    "angles that cancel": ("main", "ABS($ROBROOT.A)+ABS", "ABS($ROBROOT.A)-ABS", "syntax"),
    "a foot that stops nothing": ("main", "HALT\n", "", "syntax"),
    "a tool that is not carried": ("main", "$IPO_MODE=#BASE", "$IPO_MODE=#TCP", "type"),
    "other turns": ("main", "$ORI_TYPE=#VAR", "$ORI_TYPE=#CONSTANT", "type"),
    "half a percent": ("main", "$VEL_AXIS[3]=12", "$VEL_AXIS[3]=12.5", "type"),
    "too fast": ("moves", "$VEL.CP=0.02000000", "$VEL.CP=20.0", "type"),
    "an undeclared base": ("main", "$BASE=b_stock", "$BASE=b_stok", "undeclared"),
    "a load for a tool": ("main", "$TOOL=t_mill", "$TOOL=l_mill", "type"),
    "an undeclared target": ("main", "PTP p_1_start", "PTP p_2_start", "undeclared"),
    "a missing program": ("main", "wall_1()", "wall_2()", "undeclared"),
    "a huge number": ("moves", "Y 30.0000", "Y 3E39", "number"),
    "a hexadecimal number": ("moves", "Y 30.0000", "Y 'H1E'", "syntax"),
    "bits for a length": ("moves", "Y 30.0000", "Y 'B11110'", "type"),
    "a number and a word": ("moves", "Y 30.0000", "Y 30.0mm", "syntax"),
    "a sign apart": ("moves", "Y 30.0000", "Y - 30.0000", "syntax"),
    "a frame for a number": ("moves", "Y 30.0000", "Y {X 30.0000}", "type"),
    "a number for a frame": ("dat", "J {X 0.000000,Y 0.000000,Z 0.000000}", "J 0.0", "type"),
    "a part twice": ("moves", "X -2.0000,Y 30.0000", "X -2.0000,X -3.0,Y 30.0000", "type"),
    "no such header": ("main", "DEF wall()", "&USER x\nDEF wall()", "syntax"),
    "a header twice": ("main", "DEF wall()", "&REL 7\nDEF wall()", "syntax"),
    "a header on the way": ("main", "$ADVANCE=3", "$ADVANCE=3\n&COMMENT x", "syntax"),
    "another condition": ("main", "BAS(#", f"{STOP.replace('TRUE', 'FALSE')}BAS(#", "syntax"),
    "another reaction": ("main", "BAS(#", f"{STOP.replace('IR_STOPM', 'wall_1')}BAS(#", "syntax"),
    "swapped parts": ("moves", "X -2.0000,Y 30.0000", "Y 30.0000,X -2.0000", "type"),
    "a missing part": ("dat", ",C -4.00000", "", "type"),
    "a long name": ("dat", "b_stock=", "b_stock_that_has_a_long_name=", "name_length"),
    "a reserved name": ("dat", "FRAME b_stock=", "FRAME while=", "name_reserved"),
    "a name twice": ("dat", "FRAME b_stock=", "FRAME T_MILL=", "name_duplicate"),
    "a digest without end": ("dat", "problem_digest[64]", "problem_digest[2]", "type"),
    "S without T": ("dat", "S 2,T 35", "S 2", "type"),
    "a status of 9": ("dat", "S 2,T 35", "S 9,T 35", "type"),
    "a long line": ("main", "WAIT SEC 2.5", "WAIT SEC 2.5 ; " + "x" * 200, "line_length"),
    "another name than the file's": ("moves", "DEF wall_1()", "DEF wall_9()", "name_file"),
    "EXT": ("main", "BAS(#", "EXT wall_1()\nBAS(#", "syntax"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_not_of_the_subset_is_a_fault(name):
    file, old, new, kind = FAULTS[name]
    whole = {"dat": DAT, "main": MAIN, "moves": MOVES}[file]
    assert old in whole
    assert kind in kinds(**{file: whole.replace(old, new, 1)})


NO_WAY = {
    "an interrupt that is not on": ("main", "BAS(#", f"{STOP.splitlines()[0]}\nBAS(#", "does not start"),
    "an interrupt that is not there": ("main", "BAS(#", "INTERRUPT ON 3\nBAS(#", "does not start"),
    "an interrupt on the way": ("main", "WAIT SEC 2.5", STOP, "only"),
    "an interrupt twice": ("main", "BAS(#", f"{STOP}{STOP}BAS(#", "does not start"),
    "no INITMOV": ("main", "BAS(#INITMOV,0)\n", "", "does not start"),
    "INITMOV again": ("main", "WAIT SEC 2.5", "BAS(#INITMOV,0)", "only"),
    "no speed": ("moves", "$VEL.CP=0.02000000\n", "", "$VEL.CP is not set"),
    "no corner": ("moves", "$APO.CDIS=0.3\n", "", "$APO.CDIS is not set"),
    "one ORI": ("moves", "$VEL.ORI2=10.0\n", "", "differ"),
    "no tool": ("main", "$TOOL=t_mill\n", "", "$TOOL is not set"),
    "no base": ("main", "$BASE=b_stock\n", "", "$BASE is not set"),
    "no axis speed": ("main", "$VEL_AXIS[4]=12\n", "", "$VEL_AXIS[4] is not set"),
    "no start pose": ("main", "PTP p_1_start\n", "", "is unknown"),
    "another base on the way": ("main", "WAIT SEC 2.5", "$BASE=base_frame", "is unknown"),
    "a base in a file with moves": ("moves", "WAIT SEC 0.25", "$BASE=base_frame", "only"),
    "a halt as a question": ("main", "WAIT SEC 2.5", ";? Sure?\nHALT", "HALT is no question"),
    "half a question": ("main", dialog("and the way of the arm clear?"), "", "not followed by a dialog"),
    "a text to be read and no question": (
        "main",
        "WAIT SEC 2.5",
        dialog("Sure.", "Read", ""),
        "not followed by a question",
    ),
    "a text to be read in a question": (
        "main",
        dialog("and the way of the arm clear?"),
        dialog("Sure.", "Read", "") + dialog("and the way of the arm clear?"),
        "inside a question",
    ),
    "no options of messages": ("main", OPTIONS, "", "tm_opt is not set"),
    "no look at the foot": ("main", FOOT, "", "has checked"),
    "a foot far off": ("main", "tm_shift>0.1", "tm_shift>0.2", "allowed: 0.1 mm"),
    "a foot turned": ("main", "tm_turn>0.02", "tm_turn>0.05", "0.02 deg"),
    "the foot of another arm": ("main", "Arm left: $ROBROOT", "Arm right: $ROBROOT", "expected 'Arm left"),
    "no word of the foot": ("main", FOOT, OLD_FOOT, "expected 'Arm left"),
    "no interrupt": ("main", INTERRUPT, "", "GLOBAL INTERRUPT DECL 3"),
    "an interrupt that is off": ("main", "INTERRUPT ON 3\n", "", "INTERRUPT ON 3"),
    "an interrupt behind the settings": (
        "main",
        f"{INTERRUPT}BAS(#INITMOV,0)\n",
        f"BAS(#INITMOV,0)\n{INTERRUPT}",
        "does not start",
    ),
    "the interrupt once more": ("main", "WAIT SEC 2.5", "INTERRUPT ON 3", "only"),
    "a question among moves": ("moves", "WAIT SEC 0.25", dialog("Sure?"), "only"),
    "a look among moves": ("moves", "WAIT SEC 0.25", FOOT, "only"),
    "a state that is not cleared": ("main", "WAIT SEC 2.5", STATE, "which is not true"),
    "a state of nothing": ("main", "WAIT SEC 2.5", STATE + CLEARED, "without a wait"),
    "a state that is taken back twice": ("main", "WAIT SEC 2.5", CLEARED, "not shown"),
    "a wait without a word": ("main", "WAIT SEC 2.5", WAIT, "does not show it"),
    "a wait for nobody": (
        "main",
        "WAIT SEC 2.5",
        (STATE + WAIT + CLEARED).replace("arm right", "arm left"),
        "expected 'Waiting",
    ),
    "another tale": ("main", "WAIT SEC 2.5", STATE.replace("Waiting for", "Go to"), "expected 'Waiting"),
    "a program that calls itself": ("moves", "WAIT SEC 0.25", "wall_1()", "calls itself"),
    "a PTP among the moves": ("moves", "WAIT SEC 0.25", "PTP x_home", "only"),
}


@pytest.mark.parametrize("name", NO_WAY)
def test_what_has_no_single_way_is_refused(name):
    file, old, new, message = NO_WAY[name]
    whole = {"dat": DAT, "main": MAIN, "moves": MOVES}[file]
    assert old in whole
    with pytest.raises(FlowError, match=message.replace("$", r"\$").replace("[", r"\[")):
        steps(**{file: whole.replace(old, new, 1)})


OLD_MOVES = MOVES.replace("SLIN", "LIN").replace("C_SPL", "C_DIS")


def test_the_older_dialect_has_other_words():
    found = steps("krc2", main=OLDER, moves=OLD_MOVES)
    asked, told = (step for step in found if isinstance(step, MessageStep))
    assert (asked.kind, asked.confirm, asked.certain) == ("HALT", True, True)
    assert asked.text == "Is the stock in place and the way of the arm clear?"
    assert (told.kind, told.text, told.panel) == (";*", "The spindle starts.", "line")
    assert {fault.kind for fault in read("krc2", moves=OLD_MOVES).faults} == {"undeclared"}


QUESTION = ";? Is the stock in place\n;? and the way of the arm clear?\nHALT\n"
OLDER_NO_WAY = {
    "a question that a PLC answers": (QUESTION + NOT_EXTERNAL, QUESTION, "refuse that mode"),
    "a mode that is not looked at first": (
        NOT_EXTERNAL + ROBROOT_CHECK,
        ROBROOT_CHECK,
        "before automatic external",
    ),
    "a move between question and mode": (QUESTION, QUESTION + "$ADVANCE=3\n", "refuse that mode"),
    "a halt without a question": (QUESTION, "HALT\n", "without a question"),
    "a question without a halt": (
        QUESTION,
        QUESTION.replace("HALT\n", "WAIT SEC 1\n"),
        "not followed by a HALT",
    ),
    "no look at the foot": (OLD_FOOT, "", "has checked"),
    "a dialog": ("WAIT SEC 2.5\n", dialog("Sure?"), "not part of"),
}


@pytest.mark.parametrize("name", OLDER_NO_WAY)
def test_the_older_dialect_asks_in_no_mode_of_a_plc(name):
    old, new, message_ = OLDER_NO_WAY[name]
    assert old in OLDER
    with pytest.raises(FlowError, match=message_):
        steps("krc2", main=OLDER.replace(old, new, 1), moves=OLD_MOVES)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("WHILE $MODE_OP==#EX", "WHILE $MODE_OP==#T1"),
        ("WHILE $MODE_OP==#EX\nHALT\nENDWHILE", "IF $MODE_OP==#EX THEN\nHALT\nENDIF"),
        ("EXT BAS (BAS_COMMAND :IN,REAL :IN )\n", ""),
        ("EXT BAS (BAS_COMMAND :IN,REAL :IN )", "EXT BAS ()"),
        ("WHILE $MODE_OP==#EX\nHALT\n", "WHILE $MODE_OP==#EX\n"),
    ],
)
def test_the_older_dialect_has_its_forms_too(old, new):
    assert old in OLDER
    assert read("krc2", main=OLDER.replace(old, new), moves=OLD_MOVES).faults


HARMLESS = {
    "blanks": lambda text: text.replace("=#", " = #").replace("(tm_ticket,", "( tm_ticket , "),
    "case": lambda text: text.replace("Set_KrlDlg", "SET_KRLDLG").replace("WHILE", "while"),
    "comments": lambda text: text.replace("\nWAIT", "\n; a comment\nWAIT"),
    "blank rows": lambda text: text.replace("\nENDWHILE", "\n\nENDWHILE"),
    "declarations one by one": lambda text: text.replace(
        "DECL INT tm_ticket,tm_state,tm_answer", "DECL INT tm_answer\nDECL INT tm_state , tm_ticket"
    ),
    "other numbers of messages": lambda text: text.replace("Nr 1,", "Nr 207,"),
    "the template's blanks": lambda text: text.replace("BAS(#INITMOV,0)", "BAS (#INITMOV,0 )"),
    "a stricter look": lambda text: text.replace("tm_shift>0.1", "tm_shift>0.05"),
    "comments with marks": lambda text: text.replace("PTP x_home", ";* Home.\n;? Sure?\nPTP x_home"),
}


@pytest.mark.parametrize("name", HARMLESS)
def test_harmless_rewrites_are_read_alike(name):
    changed = HARMLESS[name](WAITS)
    assert changed != WAITS
    ways = [[(s.kind, getattr(s, "text", "")) for s in steps(main=main)] for main in (WAITS, changed)]
    assert ways[0] == ways[1]


def test_a_held_block_is_the_load_less_the_tool():
    """A tool of 2 kg, a point, and a box of 3 kg at another place make a load of 5 kg; by the parallel axis
    theorem, with the inertia of a solid box from any textbook."""
    edges = np.array([0.4, 0.2, 0.1])
    moments = 3.0 / 12.0 * ((edges**2).sum() - edges**2)
    tool = LoadData(2.0, np.array([0.0, 0.0, 0.1]), np.array([1.0, 0, 0, 0]), np.zeros(3))
    place = np.array([0.05, -0.1, 0.3])
    centre = (2.0 * tool.centre + 3.0 * place) / 5.0
    whole = np.diag(moments)
    for mass, at in ((2.0, tool.centre), (3.0, place)):
        shift = at - centre
        whole = whole + mass * (shift @ shift * np.eye(3) - np.outer(shift, shift))
    principal, axes = np.linalg.eigh(whole)
    axes[:, 2] *= np.linalg.det(axes)
    turn = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    tcp = np.eye(4)
    tcp[:3, :3] = Rotation.from_euler("ZYX", [20, 30, 40], degrees=True).as_matrix()
    tcp[:3, 3] = [0.0, 0.0, 0.2]
    found = held_load(LoadData(5.0, centre, turn, principal), tool, tcp)
    assert math.isclose(found.mass, 3.0)
    assert np.allclose(found.centre, tcp[:3, :3].T @ (place - tcp[:3, 3]))
    assert np.allclose(sorted(found.inertia), sorted(moments))
    rotated = (rotation(found.axes) * found.inertia) @ rotation(found.axes).T
    assert np.allclose(rotated, (tcp[:3, :3].T * moments) @ tcp[:3, :3])


def test_a_load_of_tool_and_block_is_told_as_carried():
    dat = DAT.replace(
        "DECL E6AXIS",
        "DECL LOAD l_block_1={M 4.250,CM {X 0.000,Y 0.000,Z 100.000,A 0.000000,B 0.000000,C 0.000000},"
        "J {X 0.200000,Y 0.200000,Z 0.100000}}\nDECL E6AXIS",
    )
    main = MAIN.replace("WAIT SEC 2.5", "$LOAD=l_block_1\nWAIT SEC 2.5").replace(
        "PTP x_home\nEND", "$LOAD=l_mill\nPTP x_home\nEND"
    )
    taken, left = (step for step in steps(dat=dat, main=main) if isinstance(step, CarryStep))
    assert math.isclose(taken.load.mass, 3.0) and taken.name == "l_block_1"
    assert left.load.mass == 0.0


def test_values_of_the_data_list():
    frame = parse_value("frame", "{X 1.0000,Y 2.0000,Z 3.0000,A 30.000000,B 20.000000,C 10.000000}")
    expected = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True).as_matrix()
    assert np.allclose(frame[:3, :3], expected) and np.allclose(frame[:3, 3], [0.001, 0.002, 0.003])


INI = """;FOLD INI;%{PE}
  ;FOLD BASISTECH INI
    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
    INTERRUPT ON 3
    BAS (#INITMOV,0 )
  ;ENDFOLD (BASISTECH INI)
  ;FOLD USER INI
    ;Make your modifications here

  ;ENDFOLD (USER INI)
;ENDFOLD (INI)
""".replace("ON 3\n", "ON 3\t \n")
REWRITTEN = {
    "the controller's own head": ("main", f"{INTERRUPT}BAS(#INITMOV,0)\n", INI),
    "its lines in the header": (
        "main",
        "DEF wall()",
        "&COMMENT h\xf6lzern; DEF x()\n&PARAM EDITMASK = *\n"
        "&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe\nDEF wall()",
    ),
    "trailing zeros": ("moves", "X -2.0000,Y 30.0000,Z 210.0000", "X -2.,Y 30,Z 210.0"),
    "an exponent": ("moves", "Y 30.0000", "Y 3.0E+01"),
    "a plus": ("moves", "Y 30.0000", "Y +30.0000"),
    "no digit before the point": ("moves", "CDIS=0.3", "CDIS=.3"),
    "a speed by exponent": ("moves", "CP=0.02000000", "CP=2.0E-02"),
    "status and turn as bits": ("dat", "S 2,T 35", "S 'B010',T 'B100011'"),
    "a negative zero": ("dat", "E1 0.0", "E1 -0.0"),
    "letters in a comment": ("moves", "; Segment cut/front: 2", "; \xe4\u2116\n; Segment cut/front: 2"),
}


@pytest.mark.parametrize("name", REWRITTEN)
def test_what_a_controller_writes_otherwise_is_read_the_same(name):
    file, old, new = REWRITTEN[name]
    whole = {"dat": DAT, "main": MAIN, "moves": MOVES}[file]
    assert old in whole
    mine, plain = (
        [s for s in steps(**changed) if isinstance(s, MoveStep)]
        for changed in ({file: whole.replace(old, new)}, {})
    )
    for one, two in zip(mine, plain, strict=True):
        assert one.procedure == two.procedure and one.time == two.time and one.zone == two.zone
        for part in ("position", "quaternion", "joints", "status", "turn"):
            a, b = getattr(one.target, part, None), getattr(two.target, part, None)
            assert a is b is None or np.array_equal(a, b), part


def test_numbers_are_those_of_single_precision():
    dat = DAT.replace("X -12.0000,Y 40.0000", "X 1234.5678,Y 40.0000")
    start = next(s.target for s in steps(dat=dat) if isinstance(s, MoveStep) and s.target_name == "p_1_start")
    assert start.position[0] == float(np.float32(1234.5678)) * 1e-3 != 1.2345678
    moves = MOVES.replace("X -2.0000", "X 1234.5678")
    move = next(s.target for s in steps(moves=moves) if isinstance(s, MoveStep) and s.kind == "SLIN")
    assert move.position[0] == start.position[0]


def test_programs_that_call_each_other_without_end_are_refused_soon():
    files = texts()
    for k in range(1, 9):
        body = f"wall_{k + 1}()\n" * 20 if k < 8 else "$OUT[17]=FALSE\n"
        files[f"left/wall_{k}.src"] = HEAD + f"DEF wall_{k}()\n{body}END\n"
    text = reader.read(files, 100_000, "krc4")
    assert text.faults == ()
    with pytest.raises(FlowError, match="too often"):
        reader.main_flow(text, text.base, NumberedSignals({}, {}), "left")
