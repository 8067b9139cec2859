"""Faults in the files for controllers, by kind. Each mutator takes a random generator and the files."""

from __future__ import annotations

import re

import numpy as np

from tests.proof.registry import Mutator, Texts
from tests.proof.registry import named as mutator

ABB: dict[str, Mutator] = {}
KUKA: dict[str, Mutator] = {}
HOME = "controller/T_ROB1/"
LEFT = "controller/left/"


def swap(texts: Texts, file: str, old: str, new: str, rng: np.random.Generator) -> Texts:
    """One of the places of ``old``, a regular expression, changed to ``new``."""
    found = list(re.finditer(old, texts[file]))
    assert found, (file, old)
    one = found[rng.integers(len(found))]
    return {**texts, file: texts[file][: one.start()] + one.expand(new) + texts[file][one.end() :]}


def without(texts: Texts, file: str, row: str, rng: np.random.Generator) -> Texts:
    """Texts without one of the lines that match."""
    lines = texts[file].split("\n")
    rows = [i for i, line in enumerate(lines) if re.search(row, line)]
    gone = rows[rng.integers(len(rows))]
    return {**texts, file: "\n".join(line for i, line in enumerate(lines) if i != gone)}


@mutator(ABB)
def file_missing(rng, texts):
    names = sorted(n for n in texts if n.startswith(HOME) and not n.endswith(".txt"))
    gone = names[rng.integers(len(names))]
    return {name: text for name, text in texts.items() if name != gone}


@mutator(ABB)
def file_of_another_job(rng, texts):
    name = ["EIO.cfg", "SYS.cfg", "TandemPower.sys"][rng.integers(3)]
    folder = ["T_ROB2/", "left/", "T_ROB1/old/", ""][rng.integers(4)]
    return {**texts, f"controller/{folder}{name}": texts[HOME + name]}


@mutator(ABB)
def file_too_many(rng, texts):
    return {
        **texts,
        f"{HOME}{['EIO2.cfg', 'PROC.cfg', 'Other.sys'][rng.integers(3)]}": texts[HOME + "EIO.cfg"],
    }


@mutator(ABB)
def or_for_and(rng, texts):
    return swap(texts, HOME + "EIO.cfg", r'-Oper(\d) "AND"', r'-Oper\1 "OR"', rng)


@mutator(ABB)
def other_signal_in_cross(rng, texts):
    new = [r'-Act\1 "doLamp"', r'-Act\1 "doWirePowerOut"', r'-Act\1 "soAutoOn"'][rng.integers(3)]
    return swap(texts, HOME + "EIO.cfg", r'-Act(\d) "\w+"', new, rng)


@mutator(ABB)
def term_missing_in_cross(rng, texts):
    pattern = [r' -Oper2 "AND" -Act3 "\w+"', r' -Oper2 "AND" -Act3 "soMotorsOn"'][rng.integers(2)]
    return swap(texts, HOME + "EIO.cfg", pattern, "", rng)


@mutator(ABB)
def inverted_term(rng, texts):
    return swap(texts, HOME + "EIO.cfg", r'(-Act(\d) "\w+")', r"\1 -Act\2_invert", rng)


@mutator(ABB)
def other_result(rng, texts):
    return swap(
        texts, HOME + "EIO.cfg", r'-Res "\w+"', f'-Res "{["doWirePower", "doLamp"][rng.integers(2)]}"', rng
    )


@mutator(ABB)
def readonly_missing(rng, texts):
    return swap(texts, HOME + "EIO.cfg", r' -Access "ReadOnly"', ["", ' -Access "All"'][rng.integers(2)], rng)


@mutator(ABB)
def request_on_a_device(rng, texts):
    new = f'"doWirePower" -SignalType "DO" -Device "Local_IO" -DeviceMap "{rng.integers(16)}"'
    return swap(texts, HOME + "EIO.cfg", r'"doWirePower" -SignalType "DO"', new, rng)


@mutator(ABB)
def signal_renamed(rng, texts):
    old = ["doWirePower", "doWirePowerOut", "soCycleOn", "soMotorsOn"][rng.integers(4)]
    return swap(texts, HOME + "EIO.cfg", rf'-(Name|Signal) "{old}"', r'-\1 "doElse"', rng)


@mutator(ABB)
def signal_on_at_first(rng, texts):
    return swap(texts, HOME + "EIO.cfg", r'(-SignalType "DO")', r"\1 -Default 1", rng)


@mutator(ABB)
def other_state(rng, texts):
    new = ["AutoOn", "MotorOn", "RunchOk", "MechUnitNotMoving"][rng.integers(4)]
    return swap(texts, HOME + "EIO.cfg", r'-Status "\w+"', f'-Status "{new}"', rng)


@mutator(ABB)
def row_missing(rng, texts):
    file = ["EIO.cfg", "SYS.cfg"][rng.integers(2)]
    return without(texts, HOME + file, r"^\s+-(Name|Status|Routine|File)", rng)


@mutator(ABB)
def hook_elsewhere(rng, texts):
    new = [r'-Shelf "POWER_ON"', r'-Shelf "\1_OLD"', '-Shelf ""'][rng.integers(3)]
    return swap(texts, HOME + "SYS.cfg", r'-Shelf "(\w+)"', new, rng)


@mutator(ABB)
def other_hook(rng, texts):
    new = ["main", "user_stop", "operation_1"][rng.integers(3)]
    return swap(texts, HOME + "SYS.cfg", r'-Routine "\w+"', f'-Routine "{new}"', rng)


@mutator(ABB)
def hook_of_another_task(rng, texts):
    return swap(texts, HOME + "SYS.cfg", r'-Task "T_ROB\d"', '-Task "T_BACK"', rng)


@mutator(ABB)
def module_not_loaded(rng, texts):
    new = ['-File "HOME:/Old.sys"', '-File "HOME:/TandemPower.mod"'][rng.integers(2)]
    return swap(texts, HOME + "SYS.cfg", r'-File "[^"]*"', new, rng)


@mutator(ABB)
def of_another_robotware(rng, texts):
    file = ["EIO.cfg", "SYS.cfg"][rng.integers(2)]
    return swap(texts, HOME + file, r"CFG_1\.0:6", f"CFG_1.0:{[5, 7][rng.integers(2)]}", rng)


@mutator(ABB)
def hook_sets_on(rng, texts):
    return swap(texts, HOME + "TandemPower.sys", r"SetDO doWirePower,0;", "SetDO doWirePower,1;", rng)


@mutator(ABB)
def hook_of_another_signal(rng, texts):
    return swap(texts, HOME + "TandemPower.sys", r"(SetDO |DOutput\()doWirePower\b", r"\1doLamp", rng)


@mutator(ABB)
def hook_without_a_line(rng, texts):
    pattern = r"SetDO|tandem_off;|:=TRUE|:=FALSE;\r?$|Stop|TPWrite|WaitUntil|:=UIMessageBox|MsgArray"
    return without(texts, HOME + "TandemPower.sys", pattern, rng)


@mutator(ABB)
def question_changed(rng, texts):
    old, new = [
        ('"Free","On"', '"On","Free"'),
        ("answer=1", "answer<>1"),
        ("answer=2 AND", "answer=2 OR"),
        ("WHILE", "IF"),
        ("is 1 again", "is 0 again"),
        ("block none of", "block some of"),
        ('"Stop"', '"Yes"'),
    ][rng.integers(7)]
    assert old in texts[HOME + "TandemPower.sys"], old
    changed = texts[HOME + "TandemPower.sys"].replace(old, new)
    return {**texts, HOME + "TandemPower.sys": changed}


@mutator(ABB)
def module_more(rng, texts):
    more = [
        "  PROC main()\r\n  ENDPROC\r\nENDMODULE",
        "  PROC extra()\r\n    SetDO doWirePower,1;\r\n  ENDPROC\r\nENDMODULE",
        "  PERS num extra:=1;\r\nENDMODULE",
    ][rng.integers(3)]
    return swap(texts, HOME + "TandemPower.sys", "ENDMODULE", more, rng)


@mutator(KUKA)
def kuka_file_missing(rng, texts):
    names = sorted(n for n in texts if n.startswith(LEFT) and not n.endswith(".txt"))
    gone = names[rng.integers(len(names))]
    return {name: text for name, text in texts.items() if name != gone}


@mutator(KUKA)
def kuka_or(rng, texts):
    return swap(texts, LEFT + "sps_user.sub", r"\bAND\b", "OR", rng)


@mutator(KUKA)
def kuka_other_output(rng, texts):
    file = ["sps_user.sub", "ir_stopm_user.src"][rng.integers(2)]
    return swap(texts, LEFT + file, r"\$OUT\[\d+\]", f"$OUT[{rng.integers(200, 300)}]", rng)


@mutator(KUKA)
def kuka_sets_on(rng, texts):
    file = ["sps_user.sub", "ir_stopm_user.src"][rng.integers(2)]
    return swap(texts, LEFT + file, r"(\$OUT\[\d+\])=FALSE", r"\1=TRUE", rng)


@mutator(KUKA)
def kuka_term_missing(rng, texts):
    return swap(texts, LEFT + "sps_user.sub", r" AND \$PERI_RDY|\$PRO_ACT AND |NOT ", "", rng)


@mutator(KUKA)
def kuka_other_state(rng, texts):
    new = ["$ALARM_STOP", "$MOVE_ENABLE", "$IN[3]"][rng.integers(3)]
    return swap(texts, LEFT + "sps_user.sub", r"\$PRO_ACT|\$PERI_RDY", new.replace("\\", ""), rng)


@mutator(KUKA)
def kuka_line_missing(rng, texts):
    file = ["sps_user.sub", "ir_stopm_user.src", "config_user.dat"][rng.integers(3)]
    return without(texts, LEFT + file, r"^[^;\s]", rng)


@mutator(KUKA)
def kuka_goes_on(rng, texts):
    new = ["$OV_PRO=100", "$OV_PRO=1"][rng.integers(2)]
    return swap(texts, LEFT + "sps_user.sub", r"\$OV_PRO=0", new, rng)


@mutator(KUKA)
def kuka_comment(rng, texts):
    file = ["sps_user.sub", "ir_stopm_user.src"][rng.integers(2)]
    return swap(texts, LEFT + file, r"(?m)^(\$OUT|TANDEM_CUT=)", r";\1", rng)


SIGNS = ("\r", "\x85", "\x0c", "\u2028")
"""What may end a line for a controller, and a comment with it."""


@mutator(ABB)
def code_in_a_comment(rng, texts):
    sign = SIGNS[rng.integers(len(SIGNS))]
    return swap(
        texts, HOME + "TandemPower.sys", r"( +! At every \w+)", rf"\1{sign}  SetDO doWirePower,1;", rng
    )


@mutator(KUKA)
def code_in_a_comment_of_krl(rng, texts):
    file = ["sps_user.sub", "ir_stopm_user.src", "config_user.dat"][rng.integers(3)]
    sign = SIGNS[rng.integers(len(SIGNS))]
    return swap(texts, LEFT + file, r"(; Written by Tandem\.)", rf"\1{sign}$OUT[17]=TRUE", rng)
