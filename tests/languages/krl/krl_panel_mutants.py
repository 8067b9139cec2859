"""Seeded faults in the questions, messages and checks of KRL programs, by kind.

Those of krc4 go into the table of ``krl_mutants``, those of krc2 into a table of their own.
"""

from __future__ import annotations

import re

from tests.languages.krl.krl_edits import MAIN, MOVES, edit, put, rows_of, where
from tests.languages.krl.krl_mutants import mutator
from tests.proof.registry import Table, into, pick

ROWS = 11
"""Rows of a dialog."""
OLDER: Table = {}
older = into(OLDER)


def dialogs(rows, key="Yes|Read|Next"):
    """Indices of the first rows of dialogs whose first key is one of these."""
    starts = [i for i, row in enumerate(rows) if row == "tm_answer=0"]
    return [i for i in starts if re.search(rf'"({key})"', rows[i + 3])]


def text_of(rows, i):
    """The text of the dialog that begins at a row."""
    return re.search(r'Msg_txt\[\] "(.*)"', rows[i + 2]).group(1)


def message_row(text):
    """The row that sets the text of a message."""
    return f'tm_msg={{Modul[] "Tandem",Nr 2,Msg_txt[] "{text}"}}'


def replaced(rng, texts, key, new):
    """Texts with one dialog replaced by the rows ``new`` (old rows)."""
    rows = rows_of(texts, MAIN)
    i = pick(rng, dialogs(rows, key))
    rows[i : i + ROWS] = new(rows[i : i + ROWS])
    return put(texts, MAIN, rows)


# ---- questions ----------------------------------------


@mutator("verify.setup")
def not_told(rng, texts):
    return replaced(rng, texts, "Read", lambda _: [])


@mutator("verify.setup")
def told_in_a_comment(rng, texts):
    return replaced(rng, texts, "Read", lambda rows: [f";* {text_of(rows, 0)}"])


@mutator("verify.setup")
def told_otherwise(rng, texts):
    word = pick(rng, ["Do not ", "Later: ", "By hand: "])
    old = 'Msg_txt[] "'
    return replaced(rng, texts, "Read", lambda rows: [row.replace(old, old + word) for row in rows])


@mutator("verify.setup")
def setup_not_asked(rng, texts):
    rows = rows_of(texts, MAIN)
    i = pick(rng, [i for i in dialogs(rows, "Yes") if text_of(rows, i).startswith("Setup")])
    first = i
    while first - ROWS in dialogs(rows, "Read"):
        first -= ROWS
    return put(texts, MAIN, [*rows[:first], *rows[i + ROWS :]])


@mutator("verify.setup")
def first_question_lost(rng, texts):
    """Every question before the first move, so that nobody is asked."""
    rows = rows_of(texts, MAIN)
    i = dialogs(rows, "Yes")[0]
    return put(texts, MAIN, [*rows[:i], *rows[i + ROWS :]])


@mutator("verify.syntax")
def answered_by_a_plc(rng, texts):
    return replaced(rng, texts, "Yes", lambda rows: [f";? {text_of(rows, 0)}", "HALT"])


@mutator("verify.syntax")
def answered_by_nobody(rng, texts):
    return replaced(rng, texts, "Yes", lambda rows: [f";? {text_of(rows, 0)}"])


@mutator("verify.syntax")
def any_answer(rng, texts):
    new = pick(rng, ["WHILE tm_answer==0", "WHILE tm_answer<1", "WHILE tm_answer<>2", "IF tm_answer<>1 THEN"])
    return edit(rng, texts, MAIN, "^WHILE tm_answer", lambda row: new)


@mutator("verify.syntax")
def answered_before(rng, texts):
    return edit(rng, texts, MAIN, "^tm_answer=0", lambda row: f"tm_answer={pick(rng, [1, 2, 7])}")


@mutator("verify.syntax")
def answer_behind(rng, texts):
    new = pick(rng, ["tm_answer=1", "EXIT", "GOTO on", "$OUT[17]=TRUE", "PTP x_home"])
    row = pick(rng, [6, 7, 8, 9, 10])
    return replaced(rng, texts, "Yes", lambda rows: [*rows[:row], new, *rows[row:]])


@mutator("verify.syntax")
def dialog_with_an_end(rng, texts):
    """A time-out by a timer or an input."""
    over = pick(rng, ["$TIMER[2]>5000", "$IN[5]", "$MODE_OP==#EX"])
    guard = [f"IF {over} THEN", "tm_answer=1", "ENDIF"]
    return replaced(rng, texts, "Yes|Read", lambda rows: [*rows[:7], *guard, *rows[7:]])


@mutator("verify.syntax")
def dialog_not_awaited(rng, texts):
    gone = pick(rng, [slice(6, 9), slice(6, 7), slice(8, 9), slice(10, 11), slice(1, 2), slice(5, 6)])

    def without(rows):
        kept = list(rows)
        del kept[gone]
        return kept

    return replaced(rng, texts, "Yes|Read", without)


@mutator("verify.syntax")
def keys_swapped(rng, texts):
    def swap(rows):
        rows = list(rows)
        rows[3], rows[4] = rows[3].replace("Yes", "No"), rows[4].replace("No", "Yes")
        return rows

    return replaced(rng, texts, "Yes", swap)


@mutator("verify.syntax")
def other_keys(rng, texts):
    new = pick(rng, ["OK", "Ja", "Next", "Read", "Skip"])
    return replaced(
        rng, texts, "Yes", lambda rows: [*rows[:3], rows[3].replace('"Yes"', f'"{new}"'), *rows[4:]]
    )


@mutator("verify.syntax")
def no_way_to_say_no(rng, texts):
    return replaced(rng, texts, "Yes", lambda rows: [*rows[:4], "tm_key[2]={SK_type #EMPTY}", *rows[5:]])


@mutator("verify.syntax")
def third_key(rng, texts):
    new = 'tm_key[3]={SK_type #VALUE,SK_txt[] "Skip"}'
    return replaced(rng, texts, "Yes", lambda rows: [*rows[:5], new, *rows[5:]])


@mutator("verify.syntax")
def question_as_a_note(rng, texts):
    kind = pick(rng, ["#NOTIFY", "#QUIT", "#WAITING", "#STATE"])
    new = f"tm_ticket=Set_KrlMsg({kind},tm_msg,tm_par[],tm_opt)"
    return replaced(rng, texts, "Yes", lambda rows: [rows[2], new])


@mutator("verify.line_length")
def text_cut_by_the_panel(rng, texts):
    more = pick(rng, [" and", " or", " but"]) * 20

    def longer(rows):
        return [*rows[:2], rows[2].replace('"}', f'{more}"}}'), *rows[3:]]

    return replaced(rng, texts, "Yes|Read", longer)


@mutator("verify.syntax")
def number_into_a_text(rng, texts):
    mark = pick(rng, ["%1", "%2", "%3"])
    old = 'Msg_txt[] "'
    return replaced(rng, texts, "Yes|Read", lambda rows: [row.replace(old, f"{old}{mark} ") for row in rows])


@mutator("verify.syntax")
def read_and_no_question(rng, texts):
    rows = rows_of(texts, MAIN)
    reads = dialogs(rows, "Read")
    i = pick(rng, [i for i in reads if i + ROWS not in reads])
    new = pick(rng, ["WAIT SEC 1", "PTP x_home", "$OUT[17]=FALSE", "$ADVANCE=3"])
    return put(texts, MAIN, [*rows[: i + ROWS], new, *rows[i + ROWS :]])


@mutator("verify.syntax")
def messages_not_prepared(rng, texts):
    return edit(rng, texts, MAIN, r"^tm_(opt|par|key)(\[[1-7]\])?=\{(VL|Par|SK_type #EMPTY)", lambda row: "")


@mutator("verify.declarations")
def variable_lost(rng, texts):
    return edit(rng, texts, MAIN, "^DECL", lambda row: "")


@mutator("verify.declarations")
def variable_more(rng, texts):
    new = pick(rng, ["DECL INT n", "DECL FRAME a_base", "DECL BOOL tm_other", "DECL REAL tm_turn"])
    file = pick(rng, [MAIN, *MOVES])
    return edit(rng, texts, file, "^DEF", lambda row: f"{row}\n{new}")


# ---- the head, settings, the robot's foot ----------------------------------------


@mutator("verify.syntax")
def interrupt_lost(rng, texts):
    return edit(rng, texts, MAIN, "INTERRUPT", lambda row: "")


@mutator("verify.syntax")
def interrupt_otherwise(rng, texts):
    old, new = pick(
        rng,
        [
            ("$STOPMESS==TRUE", "$STOPMESS==FALSE"),
            ("DECL 3", "DECL 4"),
            ("IR_STOPM ( )", "straight_1 ( )"),
            ("GLOBAL ", ""),
        ],
    )
    return edit(rng, texts, MAIN, "^GLOBAL", lambda row: row.replace(old, new))


@mutator("verify.syntax")
def interrupt_off(rng, texts):
    new = pick(rng, ["INTERRUPT OFF 3", "INTERRUPT DISABLE 3", "INTERRUPT ON 4", "INTERRUPT ON"])
    return edit(rng, texts, MAIN, "^INTERRUPT ON", lambda row: new)


@mutator("verify.syntax")
def interrupt_off_later(rng, texts):
    new = pick(rng, ["INTERRUPT OFF 3", "INTERRUPT ON 3", "INTERRUPT DISABLE", "RESUME", "BRAKE"])
    return edit(rng, texts, MAIN, r"^(PTP|\$OUT.*TRUE)", lambda row: f"{new}\n{row}")


@mutator("verify.syntax")
def another_interrupt(rng, texts):
    new = "INTERRUPT DECL 21 WHEN $IN[3]==TRUE DO straight_1()\nINTERRUPT ON 21"
    return edit(rng, texts, MAIN, "^(BAS|PTP)", lambda row: f"{new}\n{row}")


@mutator("verify.syntax")
def interrupt_behind_settings(rng, texts):
    rows = rows_of(texts, MAIN)
    i = where(rows, "^GLOBAL")[0]
    lines = rows[i : i + 2]
    del rows[i : i + 2]
    at = pick(rng, where(rows, "^(BAS|.ADVANCE|.ORI_TYPE|.OUT)"))
    return put(texts, MAIN, [*rows[: at + 1], *lines, *rows[at + 1 :]])


@mutator("verify.declarations")
def no_advance(rng, texts):
    return edit(rng, texts, MAIN, "^.ADVANCE", lambda row: f"$ADVANCE={pick(rng, [0, 1, 2, 4, 5, 6])}")


@mutator("verify.declarations")
def no_advance_later(rng, texts):
    new = f"$ADVANCE={pick(rng, [0, 1])}"
    return edit(rng, texts, MAIN, r"^straight_\d", lambda row: f"{new}\n{row}")


@mutator("verify.syntax")
def corner_set_elsewhere(rng, texts):
    new = pick(rng, ["$APO.CDIS=50.0", "$APO.CORI=20.0", "$APO.CPTP=100", "$APO.CVEL=100", "$VEL.CP=0.2"])
    return edit(rng, texts, MAIN, r"^(PTP|straight_\d)", lambda row: f"{new}\n{row}")


@mutator("verify.syntax")
def system_variable(rng, texts):
    file = pick(rng, [MAIN, *MOVES])
    names = ["$OV_PRO=10", "$RED_VEL=50", "$ACC.CP=0.1", "$ACC_AXIS[1]=20", "$CIRC_TYPE=#PATH", "$BLKNOT=1"]
    names += ["$STOPNOAPROX=FALSE", "$ROBROOT=$NULLFRAME", "$VEL.ORI3=5", "$IPO_MODE=#TCP ;", "$TIMER[2]=0"]
    names += ["$MODE_OP=#T1", "$ORI_TYPE=#JOINT", "$WORLD=b_stock", "$OV_APPL=20", "$APO.CPTP=50"]
    return edit(rng, texts, file, "^(PTP|SLIN)", lambda row: f"{pick(rng, names)}\n{row}")


@mutator("verify.syntax")
def foot_not_looked_at(rng, texts):
    rows = rows_of(texts, MAIN)
    first, last = where(rows, "^tm_shift=")[0], where(rows, "^tm_par.*Type=#EMPTY")[-1]
    return put(texts, MAIN, [*rows[:first], *rows[last + 1 :]])


@mutator("verify.syntax")
def foot_far_off(rng, texts):
    old, new = pick(
        rng, [("0.1)", "0.11)"), ("0.1)", "1.0)"), ("0.02", "0.2"), ("0.02", "0.021"), (">", "<")]
    )
    return edit(rng, texts, MAIN, r"^WHILE \(tm_shift", lambda row: row.replace(old, new))


@mutator("verify.syntax")
def foot_of_another_arm(rng, texts):
    return edit(rng, texts, MAIN, "Arm left: ", lambda row: row.replace("left", "right"))


@mutator("verify.syntax")
def foot_by_halves(rng, texts):
    old, new = pick(
        rng,
        [
            ("$ROBROOT.X*$ROBROOT.X+", ""),
            ("$ROBROOT.Z*$ROBROOT.Z", "$ROBROOT.Z"),
            ("SQRT(", "0.1*SQRT("),
            ("$ROBROOT.Y*", "-$ROBROOT.Y*"),
        ],
    )
    return edit(rng, texts, MAIN, "^tm_shift=", lambda row: row.replace(old, new))


@mutator("verify.syntax")
def foot_turned(rng, texts):
    old, new = pick(
        rng, [("+ABS($ROBROOT.C)", ""), ("ABS($ROBROOT.B)", "$ROBROOT.B"), ("+", "-"), ("ABS", "")]
    )
    return edit(rng, texts, MAIN, "^tm_turn=", lambda row: row.replace(old, new, 1))


@mutator("verify.syntax")
def foot_that_stops_nothing(rng, texts):
    gone = pick(rng, ["^HALT", "^ENDWHILE"])
    rows = rows_of(texts, MAIN)
    del rows[where(rows, gone)[0]]
    return put(texts, MAIN, rows)


@mutator("verify.syntax")
def foot_behind_the_first_move(rng, texts):
    rows = rows_of(texts, MAIN)
    first, last = where(rows, "^tm_shift=")[0], where(rows, "^tm_par.*Type=#EMPTY")[-1]
    form = rows[first : last + 1]
    del rows[first : last + 1]
    at = pick(rng, where(rows, "^PTP"))
    return put(texts, MAIN, [*rows[: at + 1], *form, *rows[at + 1 :]])


@mutator("verify.syntax")
def halts_with_power(rng, texts):
    """The look at the foot once more, or the refusal of a mode, where the power is on."""
    rows = rows_of(texts, MAIN)
    first, last = where(rows, "^tm_shift=")[0], where(rows, "^tm_par.*Type=#EMPTY")[-1]
    form = pick(rng, [rows[first : last + 1], ["WHILE $MODE_OP==#EX", "HALT", "ENDWHILE"]])
    at = pick(rng, where(rows, r"^(.OUT.*TRUE|WAIT SEC 5)"))
    return put(texts, MAIN, [*rows[: at + 1], *form, *rows[at + 1 :]])


@mutator("verify.syntax")
def state_of_nothing(rng, texts):
    text = pick(rng, ["Waiting for arm right.", "Cutting.", "Wire is cold."])
    new = f"{message_row(text)}\ntm_state=Set_KrlMsg(#STATE,tm_msg,tm_par[],tm_opt)"
    return edit(rng, texts, MAIN, r"^(PTP|straight_\d)", lambda row: f"{new}\n{row}")


# ---- the older dialect ----------------------------------------


@older("verify.syntax")
def mode_not_refused(rng, texts):
    rows = rows_of(texts, MAIN)
    i = pick(rng, where(rows, r"^WHILE .MODE_OP"))
    return put(texts, MAIN, [*rows[:i], *rows[i + 4 :]])


@older("verify.syntax")
def mode_refused_with_power(rng, texts):
    form = "WHILE $MODE_OP==#EX\nHALT\nENDWHILE"
    file, pattern = pick(rng, [(MAIN, "^(.OUT.*TRUE|WAIT SEC 5)"), (pick(rng, MOVES), "^LIN")])
    return edit(rng, texts, file, pattern, lambda row: f"{row}\n{form}")


@older("verify.syntax")
def other_mode_refused(rng, texts):
    new = pick(rng, ["==#AUT", "==#T1", "<>#EX", "==#EXT"])
    return edit(rng, texts, MAIN, r"^WHILE .MODE_OP", lambda row: row.replace("==#EX", new))


@older("verify.syntax")
def mode_refused_once(rng, texts):
    rows = rows_of(texts, MAIN)
    i = pick(rng, where(rows, r"^WHILE .MODE_OP"))
    rows[i], rows[i + 3] = "IF $MODE_OP==#EX THEN", "ENDIF"
    return put(texts, MAIN, rows)


@older("verify.syntax")
def mode_refused_without_a_stop(rng, texts):
    rows = rows_of(texts, MAIN)
    i = pick(rng, where(rows, r"^WHILE .MODE_OP"))
    rows[i + 2] = pick(rng, ["WAIT SEC 1", "", "EXIT"])
    return put(texts, MAIN, rows)


@older("verify.syntax")
def moves_before_the_mode(rng, texts):
    """Something stands between the question and the look at the mode."""
    new = pick(rng, ["PTP x_home", "$OUT[17]=TRUE", "WAIT SEC 0.1", "$ADVANCE=3"])
    rows = rows_of(texts, MAIN)
    i = pick(rng, where(rows, r"^;\?"))
    return put(texts, MAIN, [*rows[: i + 2], new, *rows[i + 2 :]])


@older("verify.syntax")
def told_within_a_form(rng, texts):
    """At a HALT inside of what is understood as a whole the panel would show it."""
    row = pick(rng, ["^WHILE .MODE_OP", r"^WHILE \(tm_shift"])
    mark, sep = pick(rng, [";*", ";?"]), pick(rng, ["\n", " "])
    return edit(rng, texts, MAIN, row, lambda row: f"{row}{sep}{mark} Reach in, the wire is cold.")


@older("verify.syntax")
def no_question(rng, texts):
    return edit(rng, texts, MAIN, r"^;\?", lambda row: "; " + row[2:])


@older("verify.setup")
def other_question_older(rng, texts):
    return edit(rng, texts, MAIN, r"^;\? Setup", lambda row: row.replace("done", "ready"))


@older("verify.setup")
def not_told_older(rng, texts):
    return edit(rng, texts, MAIN, r"^;\*", lambda row: "; " + row[2:])


@older("verify.setup")
def question_lost(rng, texts):
    rows = rows_of(texts, MAIN)
    i = pick(rng, where(rows, r"^;\?"))
    return put(texts, MAIN, [*rows[:i], *rows[i + 6 :]])


@older("verify.syntax")
def dialog_of_the_other_dialect(rng, texts):
    new = f"{message_row('Done.')}\ntm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)"
    return edit(rng, texts, MAIN, "^PTP", lambda row: f"{new}\n{row}")


@older("verify.declarations")
def bas_not_declared(rng, texts):
    return edit(rng, texts, MAIN, "^EXT BAS", lambda row: "")


@older("verify.syntax")
def bas_otherwise(rng, texts):
    new = pick(rng, ["EXT BAS ( )", "EXT BAS (BAS_COMMAND :IN)", "EXT BAS (BAS_COMMAND :OUT,REAL :IN )"])
    return edit(rng, texts, MAIN, "^EXT BAS", lambda row: new)


@older("verify.syntax")
def foot_not_looked_at_older(rng, texts):
    rows = rows_of(texts, MAIN)
    first, last = where(rows, "^tm_shift=")[0], where(rows, "^tm_turn=")[-1]
    return put(texts, MAIN, [*rows[:first], *rows[last + 2 :]])


@older("verify.syntax")
def foot_far_off_older(rng, texts):
    old, new = pick(rng, [("0.1)", "0.2)"), ("0.02", "2.0"), ("OR", "AND")])
    return edit(rng, texts, MAIN, r"^WHILE \(tm_shift", lambda row: row.replace(old, new))


@older("verify.syntax")
def interrupt_lost_older(rng, texts):
    return edit(rng, texts, MAIN, "INTERRUPT", lambda row: "")
